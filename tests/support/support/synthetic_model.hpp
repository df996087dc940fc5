#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <numbers>
#include <string>
#include <vector>

#include "face/face_model.hpp"

namespace facet::test {

namespace synthetic {

using Eigen::Vector3f;
/// A displacement, mm, at a place of the neutral surface.
using Field = std::function<Vector3f(const Vector3f&)>;

inline float bump(float x, float y, float at_x, float at_y, float sigma) {
  return std::exp(-((x - at_x) * (x - at_x) + (y - at_y) * (y - at_y)) / (2 * sigma * sigma));
}

/// Surface over the unit square (s, t), both -1 to 1: an ellipsoid's front with a nose, sockets and lips.
inline Vector3f neutral(float s, float t) {
  const float x = 75.0F * std::sin(1.25F * s);
  const float y = 105.0F * std::sin(1.2F * t);
  float z = 90.0F * std::cos(1.25F * s) * std::cos(1.2F * t) - 60.0F;
  z += 22.0F * bump(x, y, 0, -28, 9) + 12.0F * bump(x, y, 0, -10, 8);
  z -= 9.0F * (bump(x, y, 31.5F, 5, 11) + bump(x, y, -31.5F, 5, 11));
  z += 5.0F * bump(x, y, 0, -62, 12);
  return Vector3f(x, y, z);
}

/// Topology, regions and colours of a model; returns its neutral vertices.
inline std::vector<Vector3f> make_surface(int grid, face::FaceModel& model) {
  mesh::ControlMesh& control = model.control;
  control.vertex_count = grid * grid;
  const auto count = static_cast<std::size_t>(control.vertex_count);
  control.texture_coordinates.resize(2, control.vertex_count);
  control.refinable.assign(count, 0);
  control.quads.resize(4, (grid - 1) * (grid - 1));
  model.regions.assign(count, 0);
  model.mean_albedo.resize(3, control.vertex_count);

  std::vector<Vector3f> at(count);
  for (int row = 0; row < grid; ++row) {
    for (int column = 0; column < grid; ++column) {
      const int v = row * grid + column;
      const float s = 2.0F * static_cast<float>(column) / static_cast<float>(grid - 1) - 1.0F;
      const float t = 2.0F * static_cast<float>(row) / static_cast<float>(grid - 1) - 1.0F;
      const Vector3f p = at[static_cast<std::size_t>(v)] = neutral(s, t);
      control.texture_coordinates.col(v) << 0.5F * (s + 1), 0.5F * (t + 1);
      const bool edge = row == 0 || column == 0 || row == grid - 1 || column == grid - 1;
      const bool eye = bump(p.x(), p.y(), 31.5F, 5, 10) + bump(p.x(), p.y(), -31.5F, 5, 10) > 0.8F;
      const bool lips = bump(p.x() / 2, p.y(), 0, -62, 9) > 0.7F;
      const bool brow = std::abs(p.y() - 22) < 6 && std::abs(std::abs(p.x()) - 31) < 18;
      using face::Region;
      std::uint8_t bits = 0;
      const auto mark = [&bits](bool is, Region region) {
        bits = static_cast<std::uint8_t>(bits | (is ? static_cast<std::uint8_t>(region) : 0));
      };
      mark(edge, Region::Boundary);
      mark(eye, Region::Eye);
      mark(lips, Region::Lips);
      mark(brow, Region::Brow);
      mark(t > 0.8F, Region::Scalp);
      mark(!edge && !eye && t <= 0.8F, Region::Refinable);
      model.regions[static_cast<std::size_t>(v)] = bits;
      control.refinable[static_cast<std::size_t>(v)] = face::has_region(bits, Region::Refinable) ? 1 : 0;
      const float shade = eye ? 0.8F : brow ? 0.12F : 0.42F;
      model.mean_albedo.col(v) << shade, (lips ? 0.45F : 0.7F) * shade, (lips ? 0.45F : 0.55F) * shade;
    }
  }
  for (int row = 0, quad = 0; row + 1 < grid; ++row) {
    for (int column = 0; column + 1 < grid; ++column, ++quad) {
      const int v = row * grid + column;
      control.quads.col(quad) << v, v + 1, v + grid + 1, v + grid;
    }
  }
  return at;
}

/// Identity modes at one standard deviation, mm.
inline std::vector<Field> identity_modes() {
  return {
      [](const Vector3f& p) { return Vector3f(0.06F * p.x(), 0, 0); },
      [](const Vector3f& p) { return Vector3f(0, 0.05F * p.y(), 0); },
      [](const Vector3f& p) { return Vector3f(0, 0, 3.0F * bump(p.x(), p.y(), 0, -25, 14)); },
      [](const Vector3f& p) {
        return Vector3f(0, 0, 2.5F * (bump(p.x(), p.y(), 40, -35, 18) + bump(p.x(), p.y(), -40, -35, 18)));
      },
      [](const Vector3f& p) {
        return Vector3f(0, -3.0F * bump(p.x(), p.y(), 0, -95, 30), 2.0F * bump(p.x(), p.y(), 0, -95, 30));
      },
  };
}

inline Vector3f blink(const Vector3f& p, float side) {
  return Vector3f(0, -6.0F * bump(p.x(), p.y(), side * 31.5F, 9, 7), 0);
}
inline Vector3f smile(const Vector3f& p, float side) {
  const float weight = bump(p.x(), p.y(), side * 25, -62, 13);
  return Vector3f(side * 7.0F * weight, 6.0F * weight, -2.0F * weight);
}
inline std::vector<Field> expression_modes() {
  return {
      [](const Vector3f& p) {
        const float weight = 1.0F / (1.0F + std::exp((p.y() + 62.0F) / 5.0F));
        return Vector3f(0, -22.0F * weight, -6.0F * weight);
      },
      [](const Vector3f& p) { return blink(p, 1); },
      [](const Vector3f& p) { return blink(p, -1); },
      [](const Vector3f& p) { return smile(p, 1); },
      [](const Vector3f& p) { return smile(p, -1); },
      [](const Vector3f& p) { return Vector3f(0, 6.0F * bump(p.x(), p.y(), 0, 28, 16), 0); },
  };
}

/// Modes and core of a model with these neutral vertices.
inline void make_core(const std::vector<Vector3f>& at, face::FaceModel& model) {
  const std::vector<Field> identity = identity_modes();
  const std::vector<Field> expression = expression_modes();
  model.expression_names = {"jawOpen",        "eyeBlinkLeft",    "eyeBlinkRight",
                            "mouthSmileLeft", "mouthSmileRight", "browInnerUp"};
  model.expression_sigma.assign(model.expression_names.size(), 0.4F);
  model.identity_modes = static_cast<int>(identity.size()) + 1;
  model.expression_modes = static_cast<int>(expression.size()) + 1;
  model.core_mm.assign(
      at.size() * 3 * static_cast<std::size_t>(model.identity_modes * model.expression_modes), 0.0F);
  for (int i = 0; i < model.identity_modes; ++i) {
    for (int e = 0; e < model.expression_modes; ++e) {
      auto row = model.core_row(i, e);
      for (int v = 0; v < model.control.vertex_count; ++v) {
        const Vector3f& p = at[static_cast<std::size_t>(v)];
        if (i == 0) {
          row.col(v) = e == 0 ? p : expression[static_cast<std::size_t>(e - 1)](p);
        } else if (e == 0) {
          row.col(v) = identity[static_cast<std::size_t>(i - 1)](p);
        } else {
          // Expressions differ between identities: each mode makes some of them larger, others smaller.
          const float coupling = (i + e) % 2 == 0 ? 0.12F : -0.08F;
          row.col(v) = coupling * expression[static_cast<std::size_t>(e - 1)](p);
        }
      }
    }
  }
}

inline face::LandmarkAnchor anchor_at(int grid, float s, float t) {
  const float x = std::clamp(0.5F * (s + 1), 0.0F, 0.999F) * static_cast<float>(grid - 1);
  const float y = std::clamp(0.5F * (t + 1), 0.0F, 0.999F) * static_cast<float>(grid - 1);
  const int column = static_cast<int>(x);
  const int row = static_cast<int>(y);
  const float a = x - static_cast<float>(column);
  const float b = y - static_cast<float>(row);
  const int v = row * grid + column;
  return a >= b ? face::LandmarkAnchor{{v, v + 1, v + grid + 1}, {1 - a, a - b, b}}
                : face::LandmarkAnchor{{v, v + grid + 1, v + grid}, {1 - b, a, b - a}};
}

inline face::LandmarkAnchor anchor_at_mm(int grid, float x, float y) {
  return anchor_at(grid, std::asin(x / 75.0F) / 1.25F, std::asin(y / 105.0F) / 1.2F);
}

inline void make_landmarks(int grid, face::FaceModel& model) {
  model.landmarks.resize(face::FaceModel::kLandmarkCount);
  for (std::size_t i = 0; i < model.landmarks.size(); ++i) {
    // The R2 low-discrepancy sequence spreads the others evenly over the face.
    const double s = 0.5 + 0.7548776662466927 * static_cast<double>(i);
    const double t = 0.5 + 0.5698402909980532 * static_cast<double>(i);
    model.landmarks[i] = anchor_at(grid, static_cast<float>(1.7 * (s - std::floor(s)) - 0.85),
                                   static_cast<float>(1.7 * (t - std::floor(t)) - 0.9));
  }
  struct Place {
    std::size_t index;
    float x_mm;
    float y_mm;
  };
  // Subject's right eye (outer 33, inner 133, lids 159, 145), left eye, nose tip 1, mouth corners 61 and 291,
  // lips 13 and 14, chin 152, forehead 10, brows 105 and 334.
  constexpr std::array<Place, 18> kPlaces = {{{33, -46, 4},
                                              {133, -17, 4},
                                              {159, -31, 11},
                                              {145, -31, -1},
                                              {263, 46, 4},
                                              {362, 17, 4},
                                              {386, 31, 11},
                                              {374, 31, -1},
                                              {1, 0, -28},
                                              {61, -25, -62},
                                              {291, 25, -62},
                                              {13, 0, -60},
                                              {14, 0, -64},
                                              {152, 0, -93},
                                              {10, 0, 80},
                                              {105, -33, 22},
                                              {334, 33, 22},
                                              {168, 0, 5}}};
  for (const Place& place : kPlaces) {
    model.landmarks[place.index] = anchor_at_mm(grid, place.x_mm, place.y_mm);
  }
}

}  // namespace synthetic

/// A small smooth face-like model for tests that can't have the built one: a quad grid bent to a head with a
/// nose, 5 identity and 6 expression modes, a core that is genuinely bilinear, 468 landmarks (those that
/// carry a meaning in the MediaPipe mesh lie where they should: eye corners, nose tip, mouth corners, chin,
/// brow). Head frame, mm, eyes about 63 mm apart. Costs about 2 MB; grid: vertices per side, odd.
inline face::FaceModel synthetic_model(int grid = 33) {
  face::FaceModel model;
  model.name = "synthetic";
  synthetic::make_core(synthetic::make_surface(grid, model), model);
  synthetic::make_landmarks(grid, model);
  return model;
}

}  // namespace facet::test
