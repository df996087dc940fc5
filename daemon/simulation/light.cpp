#include "simulation/light.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

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

}  // namespace

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
  const auto to_camera = [](const Vector3f& direction) {
    return Vector3f(direction.x(), -direction.y(), -direction.z());
  };
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
