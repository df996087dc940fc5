#include "fit/visibility.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "fit/depth_pull.hpp"

namespace facet::fit {
namespace {

using Eigen::Matrix3Xf;
using Eigen::Vector3f;

constexpr float kCameraFacing = 0.15F;  ///< least cosine between normal and view
constexpr float kRimJumpMm = 12;        ///< in depth: another part of the face

}  // namespace

void DepthBuffer::draw(const capture::Lens& lens, const Matrix3Xf& seen, const mesh::Triangles& triangles) {
  width_ = lens.width_px;
  height_ = lens.height_px;
  depth_.assign(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_),
                std::numeric_limits<float>::infinity());
  const auto fx = static_cast<float>(lens.fx_px);
  const auto fy = static_cast<float>(lens.fy_px);
  const auto cx = static_cast<float>(lens.cx_px);
  const auto cy = static_cast<float>(lens.cy_px);
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    std::array<Vector3f, 3> corner;
    bool in_front = true;
    for (std::size_t i = 0; i < 3; ++i) {
      const Vector3f at = seen.col(triangles(static_cast<Eigen::Index>(i), t));
      in_front = in_front && at.z() > 1;
      corner[i] = {fx * at.x() / at.z() + cx, fy * at.y() / at.z() + cy, 1 / at.z()};
    }
    if (in_front) {
      fill(corner);
    }
  }
}

float DepthBuffer::at(float x, float y) const {
  const int column = static_cast<int>(std::lround(x));
  const int row = static_cast<int>(std::lround(y));
  return column >= 0 && row >= 0 && column < width_ && row < height_
             ? depth_[static_cast<std::size_t>(row) * static_cast<std::size_t>(width_) +
                      static_cast<std::size_t>(column)]
             : 0;
}

void DepthBuffer::fill(const std::array<Vector3f, 3>& corner) {
  const auto [least_x, most_x] = std::minmax({corner[0].x(), corner[1].x(), corner[2].x()});
  const auto [least_y, most_y] = std::minmax({corner[0].y(), corner[1].y(), corner[2].y()});
  const float area = (corner[1] - corner[0]).x() * (corner[2] - corner[0]).y() -
                     (corner[1] - corner[0]).y() * (corner[2] - corner[0]).x();
  if (!(std::abs(area) > 1e-9F) || !(least_x > -1e5F) || !(most_x < 1e5F) || !(least_y > -1e5F) ||
      !(most_y < 1e5F)) {
    return;
  }
  const int x0 = std::max(0, static_cast<int>(std::ceil(least_x)));
  const int x1 = std::min(width_ - 1, static_cast<int>(std::floor(most_x)));
  const int y0 = std::max(0, static_cast<int>(std::ceil(least_y)));
  const int y1 = std::min(height_ - 1, static_cast<int>(std::floor(most_y)));
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      const float px = static_cast<float>(x);
      const float py = static_cast<float>(y);
      const auto side = [&](const Vector3f& a, const Vector3f& b) {
        return ((b.x() - a.x()) * (py - a.y()) - (b.y() - a.y()) * (px - a.x())) / area;
      };
      const float w2 = side(corner[0], corner[1]);
      const float w0 = side(corner[1], corner[2]);
      const float w1 = 1 - w0 - w2;
      if (w0 >= 0 && w1 >= 0 && w2 >= 0) {
        float& depth = depth_[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
                              static_cast<std::size_t>(x)];
        depth = std::min(depth, 1 / (w0 * corner[0].z() + w1 * corner[1].z() + w2 * corner[2].z()));
      }
    }
  }
}

void find_visible(const capture::Lens& lens, const mesh::Vertices& vertices_mm, const Matrix3Xf& normals,
                  const mesh::Triangles& triangles, float margin_mm, float rim_px,
                  std::vector<std::uint8_t>& visible) {
  thread_local DepthBuffer buffer;
  const Pinhole camera(lens);
  const Matrix3Xf seen = (camera.rotation * vertices_mm).colwise() + camera.translation;
  buffer.draw(lens, seen, triangles);
  visible.assign(static_cast<std::size_t>(vertices_mm.cols()), 0);
  for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
    const Vector3f at = seen.col(v);
    const float facing = -(camera.rotation * normals.col(v)).dot(at.normalized());
    if (at.z() > 1 && facing > kCameraFacing) {
      const float x = camera.fx * at.x() / at.z() + camera.cx;
      const float y = camera.fy * at.y() / at.z() + camera.cy;
      const float drawn = buffer.at(x, y);
      bool inside = drawn > 0 && at.z() < drawn + margin_mm / facing;
      for (int i = 0; i < 8 && inside && rim_px > 0; ++i) {
        const float angle = static_cast<float>(i) * std::numbers::pi_v<float> / 4;
        inside = std::abs(buffer.at(x + rim_px * std::cos(angle), y + rim_px * std::sin(angle)) - at.z()) <
                 kRimJumpMm / facing;
      }
      visible[static_cast<std::size_t>(v)] = inside ? 1 : 0;
    }
  }
}

}  // namespace facet::fit
