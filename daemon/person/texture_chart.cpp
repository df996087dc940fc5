#include "person/texture_chart.hpp"

#include <algorithm>
#include <cmath>

#include "mesh/quads.hpp"
#include "mesh/triangle_points.hpp"

namespace facet::person {
namespace {

/// Of the chart's unit square, beside the face.
constexpr float kBorder = 0.01F;
/// A triangle that is longer spans a seam of the chart.
constexpr float kLongestShare = 0.4F;

}  // namespace

TextureChart::TextureChart(const mesh::TextureCoordinates& coordinates, const mesh::Triangles& triangles,
                           const std::vector<std::uint8_t>& face, int longer_side)
    : triangles_(triangles) {
  least_.setConstant(1e9F);
  Eigen::Vector2f largest = Eigen::Vector2f::Constant(-1e9F);
  for (Eigen::Index v = 0; v < coordinates.cols(); ++v) {
    if (face[static_cast<std::size_t>(v)] != 0) {
      least_ = least_.cwiseMin(coordinates.col(v));
      largest = largest.cwiseMax(coordinates.col(v));
    }
  }
  least_.array() -= kBorder;
  largest.array() += kBorder;
  const Eigen::Vector2f extent = largest - least_;
  scale_ = static_cast<float>(longer_side) / extent.maxCoeff();
  width_ = std::max(1, static_cast<int>(std::ceil(extent.x() * scale_)));
  height_ = std::max(1, static_cast<int>(std::ceil(extent.y() * scale_)));
  texels_ = (coordinates.colwise() - least_) * scale_;
  triangle_.assign(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_), -1);
  barycentric_.assign(triangle_.size(), Eigen::Vector3f::Zero());
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const auto corners = triangles.col(t);
    const bool counts = std::all_of(corners.begin(), corners.end(),
                                    [&](std::int32_t v) { return face[static_cast<std::size_t>(v)] != 0; });
    const Eigen::Vector2f a = at(corners[0]);
    const Eigen::Vector2f b = at(corners[1]);
    const Eigen::Vector2f c = at(corners[2]);
    const float longest = std::max({(b - a).norm(), (c - b).norm(), (a - c).norm()});
    if (!counts || longest > kLongestShare * static_cast<float>(longer_side)) {
      continue;
    }
    mesh::for_each_point(a, b, c, width_, height_, [&](int x, int y, const Eigen::Vector3f& barycentric) {
      const auto texel = static_cast<std::size_t>(y * width_ + x);
      triangle_[texel] = static_cast<std::int32_t>(t);
      barycentric_[texel] = barycentric;
    });
  }
}

std::vector<std::uint8_t> skin_with_rim(const face::FaceModel& model) {
  std::vector<std::uint8_t> face = model.control.refinable;
  for (Eigen::Index q = 0; q < model.control.quads.cols(); ++q) {
    const auto corners = model.control.quads.col(q);
    if (std::any_of(corners.begin(), corners.end(), [&](std::int32_t v) {
          return model.control.refinable[static_cast<std::size_t>(v)] != 0;
        })) {
      for (const std::int32_t v : corners) {
        face[static_cast<std::size_t>(v)] = 1;
      }
    }
  }
  return face;
}

TextureChart face_chart(const face::FaceModel& model, int longer_side) {
  return {model.control.texture_coordinates, mesh::split_quads(model.control.quads), skin_with_rim(model),
          longer_side};
}

}  // namespace facet::person
