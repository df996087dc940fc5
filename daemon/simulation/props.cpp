#include "simulation/props.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector3f;

constexpr float kPi = std::numbers::pi_v<float>;

/// Triangles of a grid of rows x columns vertices; the columns close to a ring where `around`.
/// Counter-clockwise seen from the side that rows x columns turn to.
mesh::Triangles grid_triangles(int rows, int columns, bool around) {
  const int steps = around ? columns : columns - 1;
  mesh::Triangles triangles(3, 2 * (rows - 1) * steps);
  Eigen::Index next = 0;
  for (int row = 0; row + 1 < rows; ++row) {
    for (int column = 0; column < steps; ++column) {
      const int a = row * columns + column;
      const int b = row * columns + (column + 1) % columns;
      triangles.col(next++) << a, a + columns, b + columns;
      triangles.col(next++) << a, b + columns, b;
    }
  }
  return triangles;
}

void set_plain(Surface& surface, const Vector3f& albedo, Material material) {
  surface.albedo = albedo.replicate(1, surface.vertices_mm.cols());
  surface.materials.assign(static_cast<std::size_t>(surface.vertices_mm.cols()), material);
}

void append(Surface& onto, const Surface& part) {
  const auto before = static_cast<std::int32_t>(onto.vertices_mm.cols());
  const Eigen::Index triangles_before = onto.triangles.cols();
  onto.vertices_mm.conservativeResize(3, before + part.vertices_mm.cols());
  onto.vertices_mm.rightCols(part.vertices_mm.cols()) = part.vertices_mm;
  onto.albedo.conservativeResize(3, before + part.albedo.cols());
  onto.albedo.rightCols(part.albedo.cols()) = part.albedo;
  onto.materials.insert(onto.materials.end(), part.materials.begin(), part.materials.end());
  onto.triangles.conservativeResize(3, triangles_before + part.triangles.cols());
  onto.triangles.rightCols(part.triangles.cols()) = part.triangles.array() + before;
}

/// A tube along a path.
Surface tube(const std::vector<Vector3f>& path, bool closed, float radius_mm) {
  constexpr int kAround = 10;
  const auto count = static_cast<int>(path.size());
  const int rows = closed ? count + 1 : count;
  Surface surface;
  surface.vertices_mm.resize(3, static_cast<Eigen::Index>(rows) * kAround);
  Vector3f sideways = Vector3f::UnitZ();
  for (int row = 0; row < rows; ++row) {
    const auto index = [&](int k) {
      return static_cast<std::size_t>(closed ? (k + count) % count : std::clamp(k, 0, count - 1));
    };
    const Vector3f along = (path[index(row + 1)] - path[index(row - 1)]).normalized();
    sideways -= sideways.dot(along) * along;
    if (sideways.norm() < 0.2F) {
      sideways = along.unitOrthogonal();
    }
    sideways.normalize();
    const Vector3f third = along.cross(sideways);
    for (int step = 0; step < kAround; ++step) {
      const float angle = 2 * kPi * static_cast<float>(step) / kAround;
      surface.vertices_mm.col(row * kAround + step) =
          path[index(row)] + radius_mm * (std::cos(angle) * sideways - std::sin(angle) * third);
    }
  }
  surface.triangles = grid_triangles(rows, kAround, true);
  return surface;
}

}  // namespace

Surface make_eyeball(float radius_mm, const Eigen::Vector3f& iris, std::uint64_t seed) {
  constexpr int kRings = 90;
  constexpr int kAround = 160;
  constexpr float kIris_mm = 5.9F;
  constexpr float kPupil_mm = 2.1F;
  const Noise fibres(seed, 61);
  Surface eye;
  eye.vertices_mm.resize(3, Eigen::Index{kRings} * kAround);
  eye.albedo.resize(3, Eigen::Index{kRings} * kAround);
  eye.materials.assign(std::size_t{kRings} * kAround, Material::Eye);
  for (int ring = 0; ring < kRings; ++ring) {
    // Rings lie closer round the iris, which is all that is seen.
    const float part = static_cast<float>(ring) / (kRings - 1);
    const float polar = 0.02F + (0.72F * kPi - 0.02F) * (0.6F * part + 0.4F * part * part);
    for (int step = 0; step < kAround; ++step) {
      const float turn = 2 * kPi * static_cast<float>(step) / kAround;
      const Vector3f direction(std::sin(polar) * std::cos(turn), std::sin(polar) * std::sin(turn),
                               std::cos(polar));
      const float from_axis_mm = radius_mm * polar;
      const float fibre =
          fibres.at({3.0F * std::cos(turn) * 3, 3.0F * std::sin(turn) * 3, from_axis_mm * 0.25F});
      Vector3f colour = Vector3f(0.52F, 0.47F, 0.44F) * (1 - 0.25F * smooth_step(7, 13, from_axis_mm));
      const Vector3f stroma = iris * (1 + 0.35F * fibre) * (1 - 0.6F * smooth_step(4.6F, 5.9F, from_axis_mm));
      colour = stroma + smooth_step(kIris_mm - 0.35F, kIris_mm + 0.35F, from_axis_mm) * (colour - stroma);
      colour *= 0.03F + 0.97F * smooth_step(kPupil_mm - 0.25F, kPupil_mm + 0.25F, from_axis_mm);
      eye.vertices_mm.col(ring * kAround + step) = radius_mm * direction;
      eye.albedo.col(ring * kAround + step) = colour;
    }
  }
  eye.triangles = grid_triangles(kRings, kAround, true);
  return eye;
}

Eigen::Matrix3f gaze_rotation(const Gaze& gaze) {
  return (Eigen::AngleAxisf(gaze.yaw_rad, Vector3f::UnitY()) *
          Eigen::AngleAxisf(-gaze.pitch_rad, Vector3f::UnitX()))
      .toRotationMatrix();
}

Surface make_teeth(const Anatomy& anatomy, bool upper) {
  constexpr int kRows = 16;
  constexpr int kColumns = 180;
  constexpr float kHalfWidth_mm = 23;
  constexpr float kDepth_mm = 26;    // of the arch
  constexpr float kTooth_mm = 7.6F;  // width of a front tooth
  const Vector3f middle = 0.5F * (anatomy.lip_upper + anatomy.lip_lower);
  const float half_width_mm = upper ? kHalfWidth_mm : kHalfWidth_mm - 2;
  const float front_z = middle.z() - (upper ? 8.0F : 10.0F);
  const float edge_y = middle.y() + (upper ? 0.5F : -1.5F);
  const float direction = upper ? 1.0F : -1.0F;  // from the cutting edge to the gum
  Surface teeth;
  teeth.vertices_mm.resize(3, Eigen::Index{kRows} * kColumns);
  teeth.albedo.resize(3, Eigen::Index{kRows} * kColumns);
  teeth.materials.assign(std::size_t{kRows} * kColumns, Material::Tooth);
  for (int row = 0; row < kRows; ++row) {
    const float height_mm = 13.0F * static_cast<float>(upper ? row : kRows - 1 - row) / (kRows - 1);
    for (int column = 0; column < kColumns; ++column) {
      const float x = half_width_mm * (2 * static_cast<float>(column) / (kColumns - 1) - 1);
      const float arch = x / half_width_mm;
      const float phase = std::abs(x) / kTooth_mm - std::floor(std::abs(x) / kTooth_mm);
      const float gap = std::min(phase, 1 - phase) * kTooth_mm;  // mm to the nearest gap between teeth
      const float bulge = 0.7F * smooth_step(0, 1.6F, gap) * smooth_step(-1.5F, 1.5F, height_mm);
      teeth.vertices_mm.col(row * kColumns + column) =
          Vector3f(middle.x() + x, edge_y + direction * height_mm, front_z - kDepth_mm * arch * arch + bulge);
      const float gum_line_mm = 9.0F - 1.2F * smooth_step(1.4F, 0, gap);
      const Vector3f tooth = Vector3f(0.62F, 0.56F, 0.46F) * (0.55F + 0.45F * smooth_step(0, 0.7F, gap)) *
                             (1 - 0.75F * std::abs(arch) * std::abs(arch));
      const Vector3f gum(0.28F, 0.1F, 0.09F);
      teeth.albedo.col(row * kColumns + column) =
          tooth + smooth_step(gum_line_mm - 0.4F, gum_line_mm + 0.4F, height_mm) * (gum - tooth);
    }
  }
  teeth.triangles = grid_triangles(kRows, kColumns, false);
  teeth.triangles.row(1).swap(teeth.triangles.row(2));
  return teeth;
}

Torso make_torso(const Anatomy& anatomy, const Complexion& complexion, std::uint64_t seed) {
  constexpr int kRows = 120;
  constexpr int kAround = 160;
  Random random(seed, 62);
  const Noise weave(seed, 63);
  const float grey = random.uniform(0.03F, 0.35F);
  const Vector3f cloth(grey * random.uniform(0.6F, 1.2F), grey * random.uniform(0.7F, 1.1F),
                       grey * random.uniform(0.7F, 1.4F));
  struct Section {
    float y, half_x, half_z, z;
  };
  // Heights below the chin, mm; the first lies inside the head.
  const float chin_y = anatomy.chin.y();
  const float neck_z = anatomy.chin.z() - 62;
  const std::array<Section, 7> sections{{{chin_y + 38, 46, 48, neck_z - 12},
                                         {chin_y - 8, 52, 50, neck_z - 8},
                                         {chin_y - 45, 56, 54, neck_z - 8},
                                         {chin_y - 75, 78, 62, neck_z - 12},
                                         {chin_y - 100, 150, 80, neck_z - 16},
                                         {chin_y - 150, 205, 105, neck_z - 14},
                                         {chin_y - 420, 215, 120, neck_z - 8}}};
  Torso torso;
  Surface& surface = torso.surface;
  surface.vertices_mm.resize(3, Eigen::Index{kRows} * kAround);
  surface.albedo.resize(3, Eigen::Index{kRows} * kAround);
  surface.materials.resize(std::size_t{kRows} * kAround);
  torso.hold.resize(std::size_t{kRows} * kAround);
  for (int row = 0; row < kRows; ++row) {
    const float at = static_cast<float>(row) / (kRows - 1) * static_cast<float>(sections.size() - 1);
    const auto low = std::min(static_cast<std::size_t>(at), sections.size() - 2);
    const float part =
        smooth_step(0, 1, at - static_cast<float>(low)) * 0.5F + 0.5F * (at - static_cast<float>(low));
    const auto between = [&](float Section::*member) {
      return sections[low].*member + part * (sections[low + 1].*member - sections[low].*member);
    };
    for (int step = 0; step < kAround; ++step) {
      const float turn = 2 * kPi * static_cast<float>(step) / kAround;
      const Vector3f point(between(&Section::half_x) * std::cos(turn), between(&Section::y),
                           between(&Section::z) + between(&Section::half_z) * std::sin(turn));
      const auto v = static_cast<std::size_t>(row * kAround + step);
      surface.vertices_mm.col(row * kAround + step) = point;
      const float collar = chin_y - 58 - 14 * std::max(0.0F, std::sin(turn));
      const float clothed = smooth_step(collar + 2.5F, collar - 2.5F, point.y());
      surface.materials[v] = Material::Cloth;
      const Vector3f skin = complexion.skin * (1 + 0.05F * weave.at(point / 15.0F)) * 0.85F;
      const Vector3f fabric = cloth * (1 + 0.25F * weave.fractal(point / 35.0F, 3));
      surface.albedo.col(row * kAround + step) = skin + clothed * (fabric - skin);
      torso.hold[v] = smooth_step(chin_y - 75, chin_y + 10, point.y());
    }
  }
  surface.triangles = grid_triangles(kRows, kAround, true);
  surface.triangles.row(1).swap(surface.triangles.row(2));
  return torso;
}

Surface make_glasses(const Anatomy& anatomy, std::uint64_t seed) {
  Random random(seed, 64);
  const float half_width_mm = random.uniform(24, 27);
  const float half_height_mm = random.uniform(17, 22);
  const float squareness = random.uniform(2.3F, 3.6F);  // exponent of the rims' superellipse
  const float radius_mm = random.uniform(0.9F, 1.7F);
  const float front_z =
      std::max(anatomy.nasion.z() + 6, std::max(anatomy.brow[0].z(), anatomy.brow[1].z()) + 5);
  const bool metal = random.uniform() < 0.4F;
  Surface glasses;
  for (const std::size_t side : {std::size_t{0}, std::size_t{1}}) {
    const float sign = Anatomy::side(side);
    const Vector3f eye = 0.5F * (anatomy.eye_outer[side] + anatomy.eye_inner[side]);
    const Vector3f centre(eye.x() + sign * 1.5F, eye.y() - 3, front_z);
    std::vector<Vector3f> rim;
    for (int step = 0; step < 96; ++step) {
      const float turn = 2 * kPi * static_cast<float>(step) / 96;
      const float c = std::cos(turn);
      const float s = std::sin(turn);
      const float x = half_width_mm * std::copysign(std::pow(std::abs(c), 2 / squareness), c);
      const float y = half_height_mm * std::copysign(std::pow(std::abs(s), 2 / squareness), s);
      rim.emplace_back(centre + Vector3f(x, y, -0.006F * (x + sign * 8) * (x + sign * 8)));
    }
    append(glasses, tube(rim, true, radius_mm));
    std::vector<Vector3f> temple;
    const Vector3f hinge =
        centre + Vector3f(sign * half_width_mm, 7, -0.006F * (half_width_mm + 8) * (half_width_mm + 8));
    for (int step = 0; step <= 40; ++step) {
      const float part = static_cast<float>(step) / 40;
      temple.emplace_back(hinge.x() + sign * 22 * smooth_step(0, 0.5F, part),
                          hinge.y() - 6 * part * part * part, hinge.z() - 110 * part);
    }
    append(glasses, tube(temple, false, radius_mm));
  }
  const float left_x = 0.5F * (anatomy.eye_outer[1].x() + anatomy.eye_inner[1].x()) + 1.5F - half_width_mm;
  const float right_x = 0.5F * (anatomy.eye_outer[0].x() + anatomy.eye_inner[0].x()) - 1.5F + half_width_mm;
  std::vector<Vector3f> bridge;
  for (int step = 0; step <= 20; ++step) {
    const float part = static_cast<float>(step) / 20;
    const float arch = 4 * part * (1 - part);
    bridge.emplace_back(right_x + part * (left_x - right_x), anatomy.nasion.y() - 1 + 3 * arch,
                        front_z - 1 + 2 * arch);
  }
  append(glasses, tube(bridge, false, radius_mm));
  set_plain(glasses, metal ? Vector3f(0.3F, 0.28F, 0.25F) : Vector3f(0.02F, 0.018F, 0.018F), Material::Frame);
  return glasses;
}

}  // namespace facet::simulation
