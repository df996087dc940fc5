#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::person {

/// The face's part of a model's texture chart in texels: which triangle each lies in, and where in it.
/// Immutable; any thread.
class TextureChart {
 public:
  /// coordinates  [2][vertex_count] of the model
  /// triangles    [3][triangle_count]
  /// face         [vertex_count] 1: triangles of such vertices alone count
  /// longer_side  of the chart, texels
  TextureChart(const mesh::TextureCoordinates& coordinates, const mesh::Triangles& triangles,
               const std::vector<std::uint8_t>& face, int longer_side);

  int width() const { return width_; }
  int height() const { return height_; }
  /// [height][width] index of the triangle that holds the texel, -1 where none does.
  const std::vector<std::int32_t>& triangle() const { return triangle_; }
  /// Where a vertex lies, texels: x to the right, y along v. May be outside for vertices beyond the face.
  Eigen::Vector2f at(Eigen::Index vertex) const { return texels_.col(vertex); }

  /// values [n][vertex_count] at a texel (row major index) that a triangle holds.
  template <typename Values>
  auto spread(const Values& values, std::size_t texel) const {
    const auto corners = triangles_.col(triangle_[texel]);
    const Eigen::Vector3f& b = barycentric_[texel];
    return (b[0] * values.col(corners[0]) + b[1] * values.col(corners[1]) + b[2] * values.col(corners[2]))
        .eval();
  }

 private:
  int width_ = 0;
  int height_ = 0;
  mesh::Triangles triangles_;
  Eigen::Matrix2Xf texels_;                   ///< [2][vertex_count]
  std::vector<std::int32_t> triangle_;        ///< [height][width]
  std::vector<Eigen::Vector3f> barycentric_;  ///< [height][width]
};

/// Calls at(x, y, barycentric) for every whole point (x, y) within a triangle and the bounds [0, width) x [0,
/// height).
template <typename At>
void for_each_point(const Eigen::Vector2f& a, const Eigen::Vector2f& b, const Eigen::Vector2f& c, int width,
                    int height, At&& at) {
  const Eigen::Vector2f ab = b - a;
  const Eigen::Vector2f ac = c - a;
  const float doubled_area = ab.x() * ac.y() - ac.x() * ab.y();
  if (!(std::abs(doubled_area) > 1e-9F)) {
    return;
  }
  const auto first = [](float least) { return std::max(0, static_cast<int>(std::ceil(least))); };
  const auto last = [](float most, int end) { return std::min(end - 1, static_cast<int>(std::floor(most))); };
  constexpr float kEdge = 1e-5F;
  const int end_y = last(std::max({a.y(), b.y(), c.y()}), height);
  const int end_x = last(std::max({a.x(), b.x(), c.x()}), width);
  for (int y = first(std::min({a.y(), b.y(), c.y()})); y <= end_y; ++y) {
    for (int x = first(std::min({a.x(), b.x(), c.x()})); x <= end_x; ++x) {
      const Eigen::Vector2f p = Eigen::Vector2f(static_cast<float>(x), static_cast<float>(y)) - a;
      const float at_b = (p.x() * ac.y() - ac.x() * p.y()) / doubled_area;
      const float at_c = (ab.x() * p.y() - p.x() * ab.y()) / doubled_area;
      if (at_b >= -kEdge && at_c >= -kEdge && at_b + at_c <= 1 + kEdge) {
        at(x, y, Eigen::Vector3f(1 - at_b - at_c, at_b, at_c));
      }
    }
  }
}

}  // namespace facet::person
