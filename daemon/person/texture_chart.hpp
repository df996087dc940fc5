#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "face/face_model.hpp"
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
  /// Texture coordinates of the first texel's middle.
  const Eigen::Vector2f& least() const { return least_; }
  float texels_per_unit() const { return scale_; }
  /// [height][width] index of the triangle that holds the texel, -1 where none does.
  const std::vector<std::int32_t>& triangle() const { return triangle_; }
  /// [height][width] weights of its corners, 0 where there is none.
  const std::vector<Eigen::Vector3f>& barycentric() const { return barycentric_; }
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
  Eigen::Vector2f least_;
  float scale_ = 1;
  Eigen::Matrix2Xf texels_;                   ///< [2][vertex_count]
  std::vector<std::int32_t> triangle_;        ///< [height][width]
  std::vector<Eigen::Vector3f> barycentric_;  ///< [height][width]
};

/// [vertex_count] 1: the skin, and what shares a quad with it.
std::vector<std::uint8_t> skin_with_rim(const face::FaceModel& model);

/// The chart of a model's skin and its rim.
TextureChart face_chart(const face::FaceModel& model, int longer_side);

}  // namespace facet::person
