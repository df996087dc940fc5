#include "simulation/light.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "facet/error.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector3f;

constexpr float kDegree = std::numbers::pi_v<float> / 180;

/// Azimuth to the picture's right, elevation up; lighting frame.
Vector3f direction_of(float azimuth_deg, float elevation_deg) {
  const float azimuth = azimuth_deg * kDegree;
  const float elevation = elevation_deg * kDegree;
  return {std::sin(azimuth) * std::cos(elevation), std::sin(elevation),
          std::cos(azimuth) * std::cos(elevation)};
}

void add(std::array<float, 9>& sum, const std::array<float, 9>& light, float strength) {
  for (std::size_t k = 0; k < sum.size(); ++k) {
    sum[k] += strength * light[k];
  }
}

/// A rectangle that faces the head from a direction (camera frame).
AreaLight rectangle(const Vector3f& head_mm, const Vector3f& direction, float distance_mm,
                    float half_width_mm, float half_height_mm) {
  AreaLight light;
  light.reference_distance_mm = distance_mm;
  light.centre_mm = head_mm + distance_mm * direction;
  light.normal = -direction;
  const Vector3f u = direction.cross(Vector3f(0, 1, 0)).normalized();
  light.half_u_mm = half_width_mm * u;
  light.half_v_mm = half_height_mm * u.cross(direction).normalized();
  return light;
}

Vector3f to_camera(const Vector3f& direction) {
  return {direction.x(), -direction.y(), -direction.z()};
}

/// Small lamps near the head: bright side, dark side, hard shadows.
void add_lamps(Random& random, const Vector3f& head_mm, Lighting& lighting) {
  const int count = 2 + random.below(2);
  float side = random.uniform() < 0.5F ? -1.0F : 1.0F;
  for (int k = 0; k < count; ++k) {
    const Vector3f direction =
        to_camera(direction_of(side * random.uniform(18, 75), random.uniform(-10, 50)));
    const float half_mm = random.uniform(25, 90);
    AreaLight light = rectangle(head_mm, direction, random.uniform(400, 800), half_mm, half_mm);
    const float warmth = random.uniform();
    light.irradiance = (k == 0 ? 1.0F : random.uniform(0.25F, 0.7F)) *
                       Vector3f(1 + 0.06F * warmth, 1 - 0.03F * warmth, 1 - 0.18F * warmth);
    lighting.area_lights.push_back(light);
    side = -side;
  }
}

/// A window at one side, 1 to 2 m away; what the room throws back is weak and warm.
void add_window(Random& random, const Vector3f& head_mm, Lighting& lighting) {
  const float side = random.uniform() < 0.5F ? -1.0F : 1.0F;
  const Vector3f direction = to_camera(direction_of(side * random.uniform(25, 80), random.uniform(5, 25)));
  AreaLight window = rectangle(head_mm, direction, random.uniform(1000, 2000), random.uniform(350, 600),
                               random.uniform(450, 700));
  window.irradiance = Vector3f(0.96F, 1.0F, 1.05F);
  lighting.area_lights.push_back(window);
  const Vector3f room = to_camera(direction_of(-side * random.uniform(40, 70), random.uniform(10, 40)));
  AreaLight wall = rectangle(head_mm, room, random.uniform(1200, 1800), 600, 500);
  wall.irradiance = random.uniform(0.1F, 0.25F) * Vector3f(1.08F, 0.98F, 0.86F);
  lighting.area_lights.push_back(wall);
}

/// Diodes evenly on a circle round the camera, which stands at the origin.
void add_ring(Random& random, const Vector3f& head_mm, Lighting& lighting) {
  constexpr int kDiodes = 10;
  const float radius_mm = random.uniform(120, 230);
  const float half_mm = 0.2F * radius_mm;
  for (int k = 0; k < kDiodes; ++k) {
    const float turn = 2 * std::numbers::pi_v<float> * (static_cast<float>(k) + 0.5F) / kDiodes;
    const Vector3f at_mm(radius_mm * std::cos(turn), radius_mm * std::sin(turn), 0);
    const Vector3f away = at_mm - head_mm;
    AreaLight light = rectangle(head_mm, away.normalized(), away.norm(), half_mm, half_mm);
    light.irradiance = Vector3f(1.0F, 0.98F, 0.95F) / kDiodes;
    lighting.area_lights.push_back(light);
  }
}

/// A small lamp.
AreaLight diode(const Vector3f& head_mm, float azimuth_deg, float elevation_deg, float distance_mm) {
  constexpr float kHalf_mm = 12;
  AreaLight light = rectangle(head_mm, to_camera(direction_of(azimuth_deg, elevation_deg)), distance_mm,
                              kHalf_mm, kHalf_mm);
  light.irradiance = Vector3f(1, 1, 1);
  return light;
}

/// Lamps of an active photometric rig: known places, small, all equally bright at the head.
void add_strobe(const Vector3f& head_mm, Lighting& lighting) {
  constexpr std::array<std::array<float, 2>, 6> kFrom{
      {{-50, 20}, {50, 20}, {0, 45}, {-28, -18}, {28, -18}, {0, 8}}};  // azimuth, elevation; degrees
  constexpr float kDistance_mm = 700;
  for (const auto& [azimuth_deg, elevation_deg] : kFrom) {
    lighting.area_lights.push_back(diode(head_mm, azimuth_deg, elevation_deg, kDistance_mm));
  }
}

constexpr int kBurstLights = 4;

AreaLight burst_lamp(const Vector3f& head_mm, int lamp) {
  constexpr std::array<std::array<float, 2>, kBurstLights> kFrom{{{-27, 10}, {27, 10}, {0, 30}, {0, -27}}};
  constexpr float kDistance_mm = 600;
  const auto& [azimuth_deg, elevation_deg] = kFrom.at(static_cast<std::size_t>(lamp));
  return diode(head_mm, azimuth_deg, elevation_deg, kDistance_mm);
}

/// Left, right, upper, lower half of a screen, the camera in the middle of whose upper edge looks along its
/// normal.
AreaLight screen_half(const Vector3f& head_mm, int half) {
  constexpr float kWidth_mm = 530;
  constexpr float kHeight_mm = 300;
  constexpr float kBelowCamera_mm = 15;
  const bool beside = half < 2;
  const float sign = half % 2 == 0 ? -1.0F : 1.0F;
  AreaLight light;
  light.half_u_mm = Vector3f(beside ? kWidth_mm / 4 : kWidth_mm / 2, 0, 0);
  light.half_v_mm = Vector3f(0, beside ? kHeight_mm / 2 : kHeight_mm / 4, 0);
  light.centre_mm = Vector3f(beside ? sign * kWidth_mm / 4 : 0,
                             kBelowCamera_mm + kHeight_mm / 2 + (beside ? 0 : sign * kHeight_mm / 4), 0);
  light.normal = Vector3f(0, 0, 1);
  light.reference_distance_mm = (light.centre_mm - head_mm).norm();
  // It is the head that gets 1, not what lies along the screen's normal.
  const float cosine = light.normal.dot(head_mm - light.centre_mm) / light.reference_distance_mm;
  light.irradiance = Vector3f::Constant(1 / cosine);
  return light;
}

Lighting make_near_lighting(LightKind kind, std::uint64_t seed, const Vector3f& head_mm) {
  Random random(seed, 32);
  Lighting lighting;
  lighting.kind = kind;
  // Of the room, over a main light of 1.
  const float ambient = kind == LightKind::Strobe  ? 0.02F
                        : kind == LightKind::Lamps ? random.uniform(0.06F, 0.16F)
                                                   : random.uniform(0.12F, 0.22F);
  lighting.spherical_harmonics[0] = ambient;
  add(lighting.spherical_harmonics, distant_light_sh({0, 1, 0}), 0.5F * ambient);
  add(lighting.spherical_harmonics, distant_light_sh({0, -1, 0}), 0.2F * ambient);
  switch (kind) {
    case LightKind::Lamps:
      add_lamps(random, head_mm, lighting);
      break;
    case LightKind::Window:
      add_window(random, head_mm, lighting);
      break;
    case LightKind::Ring:
      add_ring(random, head_mm, lighting);
      break;
    case LightKind::Strobe:
      add_strobe(head_mm, lighting);
      break;
    case LightKind::SphericalHarmonics:
    case LightKind::Area:
      break;
  }
  lighting.main_directions.reserve(lighting.area_lights.size());
  lighting.main_strengths.reserve(lighting.area_lights.size());
  for (const AreaLight& light : lighting.area_lights) {
    lighting.main_directions.emplace_back(-light.normal);
    lighting.main_strengths.push_back(light.irradiance.y());
  }
  return lighting;
}

struct NamedLight {
  const char* name;
  LightKind kind;
};
constexpr std::array<std::pair<const char*, Burst>, 3> kBursts{
    {{"lamps", Burst::Lamps}, {"screen", Burst::Screen}, {"dim-screen", Burst::DimScreen}}};
constexpr std::array<NamedLight, 6> kNames{{{"sh", LightKind::SphericalHarmonics},
                                            {"area", LightKind::Area},
                                            {"lamps", LightKind::Lamps},
                                            {"window", LightKind::Window},
                                            {"ring", LightKind::Ring},
                                            {"strobe", LightKind::Strobe}}};

}  // namespace

std::string light_name(LightKind kind) {
  return std::find_if(kNames.begin(), kNames.end(), [&](const NamedLight& one) { return one.kind == kind; })
      ->name;
}

std::vector<std::string> light_names() {
  std::vector<std::string> names;
  names.reserve(kNames.size());
  for (const NamedLight& one : kNames) {
    names.emplace_back(one.name);
  }
  return names;
}

LightKind parse_light(const std::string& name) {
  const auto found =
      std::find_if(kNames.begin(), kNames.end(), [&](const NamedLight& one) { return one.name == name; });
  if (found == kNames.end()) {
    throw Error(ErrorKind::Usage,
                fmt::format("--light '{}': the lights are {}", name, fmt::join(light_names(), ", ")));
  }
  return found->kind;
}

std::array<float, 9> distant_light_sh(const Eigen::Vector3f& direction) {
  const float x = direction.x();
  const float y = direction.y();
  const float z = direction.z();
  // c^2 in the basis, with nx^2 + ny^2 + nz^2 = 1: nz^2 = (s + 1) / 3 and nx^2, ny^2 = (2 - s) / 6 +- d / 2
  // for s = 3 nz^2 - 1 and d = nx^2 - ny^2. The constant 1/3 cancels against the -1.
  constexpr float kSecond = 15.0F / 32;
  return {0.25F,
          0.5F * x,
          0.5F * y,
          0.5F * z,
          kSecond * 2 * x * y,
          kSecond * 2 * x * z,
          kSecond * 2 * y * z,
          kSecond * 0.5F * (x * x - y * y),
          kSecond * (z * z / 3 - (x * x + y * y) / 6)};
}

Lighting make_lighting(LightKind kind, std::uint64_t seed, const Eigen::Vector3f& head_mm) {
  if (kind != LightKind::SphericalHarmonics && kind != LightKind::Area) {
    return make_near_lighting(kind, seed, head_mm);
  }
  Random random(seed, 31);
  const float side = random.uniform() < 0.5F ? -1.0F : 1.0F;
  const float key_azimuth_deg = side * random.uniform(22, 58);
  const float key_elevation_deg = random.uniform(12, 42);
  const float fill_azimuth_deg = -side * random.uniform(35, 70);
  const float fill_elevation_deg = random.uniform(-5, 20);
  const Vector3f key = direction_of(key_azimuth_deg, key_elevation_deg);
  const Vector3f fill = direction_of(fill_azimuth_deg, fill_elevation_deg);
  const float fill_strength = random.uniform(0.15F, 0.32F);
  const float ambient = random.uniform(0.14F, 0.24F);

  Lighting lighting;
  lighting.kind = kind;
  lighting.spherical_harmonics[0] = ambient;
  add(lighting.spherical_harmonics, distant_light_sh({0, 1, 0}), 0.5F * ambient);   // sky
  add(lighting.spherical_harmonics, distant_light_sh({0, -1, 0}), 0.2F * ambient);  // floor
  lighting.main_directions = {to_camera(key), to_camera(fill)};
  lighting.main_strengths = {1.0F, fill_strength};
  if (kind == LightKind::SphericalHarmonics) {
    add(lighting.spherical_harmonics, distant_light_sh(key), 1.0F);
    add(lighting.spherical_harmonics, distant_light_sh(fill), fill_strength);
    return lighting;
  }
  const std::array<Vector3f, 2> tints{Vector3f(1.0F, 0.94F, 0.86F), Vector3f(0.92F, 0.97F, 1.05F)};
  for (std::size_t k = 0; k < lighting.main_directions.size(); ++k) {
    const Vector3f& direction = lighting.main_directions[k];
    AreaLight light;
    light.reference_distance_mm = random.uniform(800, 1300);
    light.centre_mm = head_mm + light.reference_distance_mm * direction;
    light.normal = -direction;
    const Vector3f u = direction.cross(Vector3f(0, 1, 0)).normalized();
    light.half_u_mm = random.uniform(140, 320) * u;
    light.half_v_mm = random.uniform(180, 380) * u.cross(direction).normalized();
    light.irradiance = lighting.main_strengths[k] * tints[k];
    lighting.area_lights.push_back(light);
  }
  return lighting;
}

Burst parse_burst(const std::string& name) {
  const auto found =
      std::find_if(kBursts.begin(), kBursts.end(), [&](const auto& one) { return one.first == name; });
  if (found == kBursts.end()) {
    throw Error(ErrorKind::Usage, fmt::format("--burst '{}': lamps, screen or dim-screen", name));
  }
  return found->second;
}

std::string burst_name(Burst burst) {
  const auto found =
      std::find_if(kBursts.begin(), kBursts.end(), [&](const auto& one) { return one.second == burst; });
  return found == kBursts.end() ? "" : found->first;
}

Lighting burst_light(Burst burst, const Lighting& room, const Vector3f& head_mm, int frame, int& lamp) {
  constexpr int kFrames = 3;
  const float share = burst == Burst::Screen ? 0.2F : 0.5F;  // of all light that is the fired one's
  Lighting now = room;
  float main = 0;
  for (const float strength : room.main_strengths) {
    // A ring's diodes are one lamp.
    main = room.kind == LightKind::Ring ? main + strength : std::max(main, strength);
  }
  for (float& coefficient : now.spherical_harmonics) {
    coefficient *= 1 - share;
  }
  for (AreaLight& light : now.area_lights) {
    light.irradiance *= 1 - share;
  }
  for (float& strength : now.main_strengths) {
    strength *= 1 - share;
  }
  now.kind = LightKind::Area;  // of all frames alike: what a lamp adds is seen by the difference
  lamp = frame / kFrames % (kBurstLights + 1);
  if (lamp == kBurstLights) {
    lamp = -1;
    return now;
  }
  AreaLight light = burst == Burst::Lamps ? burst_lamp(head_mm, lamp) : screen_half(head_mm, lamp);
  light.irradiance *= share * main;
  now.main_directions.emplace_back((light.centre_mm - head_mm).normalized());
  now.main_strengths.push_back(share * main);
  now.area_lights.push_back(light);
  return now;
}

Lighting lighting_of_frame(const Lighting& lighting, int frame) {
  if (lighting.kind != LightKind::Strobe) {
    return lighting;
  }
  const std::size_t lamp = static_cast<std::size_t>(frame) % lighting.area_lights.size();
  Lighting now = lighting;
  now.area_lights = {lighting.area_lights[lamp]};
  now.main_directions = {lighting.main_directions[lamp]};
  now.main_strengths = {lighting.main_strengths[lamp]};
  return now;
}

std::vector<Eigen::Vector3f> light_points_mm(const AreaLight& light, int count) {
  std::vector<Vector3f> points;
  for (int row = 0; row < count; ++row) {
    for (int column = 0; column < count; ++column) {
      // Rows shifted against each other: shadows show fewer steps along either side.
      const float shift = count > 1 ? static_cast<float>(row) / static_cast<float>(count) - 0.5F : 0;
      const float u = (static_cast<float>(column) + 0.5F + 0.8F * shift) / static_cast<float>(count) * 2 - 1;
      const float v = (static_cast<float>(row) + 0.5F) / static_cast<float>(count) * 2 - 1;
      points.emplace_back(light.centre_mm + u * light.half_u_mm + v * light.half_v_mm);
    }
  }
  return points;
}

}  // namespace facet::simulation
