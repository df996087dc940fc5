#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "light/lamps.hpp"
#include "mesh/mesh.hpp"

namespace facet::light {

/// Which directions of the room each vertex of a head sees past the head itself: the visibility of
/// precomputed radiance transfer [SKS02], one number a direction.
class HeadVisibility {
 public:
  HeadVisibility() = default;

  /// Draws a depth map of the head from each direction. vertices and normals: head frame, mm and unit. 0.2 s
  /// for 8,000 vertices.
  HeadVisibility(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                 const mesh::Triangles& triangles);

  bool empty() const { return seen_.empty(); }

  /// [vertex_count] 0 to 255 of a direction of the head's frame: how much of it is seen.
  const std::uint8_t* of_direction(int direction) const {
    return seen_.data() + static_cast<std::size_t>(direction) * vertex_count_;
  }

 private:
  std::size_t vertex_count_ = 0;
  std::vector<std::uint8_t> seen_;  ///< [kRoomDirections][vertex_count]
};

/// The same of a small lamp: [vertex_count] 0 to 1, how much of it a vertex sees past the head.
///
/// place_mm  head frame, outside of the head
Eigen::ArrayXf seen_from_lamp(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                              const mesh::Triangles& triangles, const Eigen::Vector3f& place_mm);

}  // namespace facet::light
