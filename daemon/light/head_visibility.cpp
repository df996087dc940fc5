#include "light/head_visibility.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "mesh/triangle_points.hpp"

namespace facet::light {
namespace {

// Side of a depth map's pixel, mm: a third of the distance between the vertices of M0.
constexpr float kPixelMm = 1.25F;
// A vertex looks from so far above the skin, so that a flat mesh does not hide itself.
constexpr float kLiftMm = 2;
// Of a lamp: what is nearer lies beside it.
constexpr float kNearestMm = 50;

/// Depths of what is seen in one direction; what is nearer to the eye is larger. Points are x and y in pixels
/// of the map, and depth.
class DepthMap {
 public:
  DepthMap(const Eigen::Matrix3Xf& points, const mesh::Triangles& triangles) {
    low_ = points.topRows<2>().rowwise().minCoeff().array() - 2;
    const Eigen::Array2f high = points.topRows<2>().rowwise().maxCoeff().array() + 3;
    size_ = (high - low_).ceil().cast<int>();
    depths_.assign(static_cast<std::size_t>(size_.x()) * static_cast<std::size_t>(size_.y()),
                   -std::numeric_limits<float>::infinity());
    for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
      draw(points.col(triangles(0, t)), points.col(triangles(1, t)), points.col(triangles(2, t)));
    }
  }

  /// Share of the four pixels around a point that nothing nearer covers, 0 to 1, by bilinear weights.
  float seen(const Eigen::Vector3f& point) const {
    const Eigen::Array2f at = point.head<2>().array() - low_;
    const Eigen::Array2i first = at.floor().cast<int>();
    if ((first < 0).any() || (first + 1 >= size_).any()) {
      return 1;
    }
    const Eigen::Array2f share = at - first.cast<float>();
    const auto open = [&](int x, int y) {
      return depths_[place(first.x() + x, first.y() + y)] > point.z() ? 0.0F : 1.0F;
    };
    return (1 - share.y()) * ((1 - share.x()) * open(0, 0) + share.x() * open(1, 0)) +
           share.y() * ((1 - share.x()) * open(0, 1) + share.x() * open(1, 1));
  }

 private:
  std::size_t place(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(size_.x()) + static_cast<std::size_t>(x);
  }

  void draw(const Eigen::Vector3f& a, const Eigen::Vector3f& b, const Eigen::Vector3f& c) {
    const Eigen::Vector3f depths(a.z(), b.z(), c.z());
    const Eigen::Vector2f low = low_.matrix();
    mesh::for_each_point(a.head<2>() - low, b.head<2>() - low, c.head<2>() - low, size_.x(), size_.y(),
                         [&](int x, int y, const Eigen::Vector3f& barycentric) {
                           float& there = depths_[place(x, y)];
                           there = std::max(there, barycentric.dot(depths));
                         });
  }

  Eigen::Array2f low_;
  Eigen::Array2i size_;
  std::vector<float> depths_;  ///< [height][width] along the direction, mm
};

}  // namespace

HeadVisibility::HeadVisibility(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                               const mesh::Triangles& triangles)
    : vertex_count_(static_cast<std::size_t>(vertices_mm.cols())),
      seen_(vertex_count_ * static_cast<std::size_t>(kRoomDirections)) {
  const mesh::Vertices lifted = vertices_mm + kLiftMm * normals;
  for (int d = 0; d < kRoomDirections; ++d) {
    const Eigen::Vector3f direction = room_directions().col(d);
    const Eigen::Vector3f beside = direction.unitOrthogonal();
    Eigen::Matrix3f map_from_head;
    map_from_head << beside.transpose() / kPixelMm, direction.cross(beside).transpose() / kPixelMm,
        direction.transpose();
    const DepthMap map(map_from_head * vertices_mm, triangles);
    std::uint8_t* const out = seen_.data() + static_cast<std::size_t>(d) * vertex_count_;
    for (std::size_t v = 0; v < vertex_count_; ++v) {
      out[v] = static_cast<std::uint8_t>(
          std::lround(255 * map.seen(map_from_head * lifted.col(static_cast<Eigen::Index>(v)))));
    }
  }
}

Eigen::ArrayXf seen_from_lamp(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                              const mesh::Triangles& triangles, const Eigen::Vector3f& place_mm) {
  const Eigen::Vector3f middle_mm = vertices_mm.rowwise().mean();
  const float distance_mm = (place_mm - middle_mm).norm();
  const Eigen::Vector3f towards = (place_mm - middle_mm) / distance_mm;
  const Eigen::Vector3f beside = towards.unitOrthogonal();
  const Eigen::Vector3f above = towards.cross(beside);
  // As the lamp sees it: straight edges stay straight, and so does 1 / distance along them.
  const auto drawn = [&](const Eigen::Vector3f& at_mm) -> Eigen::Vector3f {
    const Eigen::Vector3f from_middle = at_mm - middle_mm;
    const float ahead_mm = std::max(distance_mm - towards.dot(from_middle), kNearestMm);
    const float zoom = distance_mm / ahead_mm;
    return {zoom * beside.dot(from_middle) / kPixelMm, zoom * above.dot(from_middle) / kPixelMm,
            distance_mm * zoom};
  };
  Eigen::Matrix3Xf points(3, vertices_mm.cols());
  for (Eigen::Index v = 0; v < points.cols(); ++v) {
    points.col(v) = drawn(vertices_mm.col(v));
  }
  const DepthMap map(points, triangles);
  Eigen::ArrayXf out(points.cols());
  for (Eigen::Index v = 0; v < points.cols(); ++v) {
    out[v] = map.seen(drawn(vertices_mm.col(v) + kLiftMm * normals.col(v)));
  }
  return out;
}

}  // namespace facet::light
