#pragma once

#include <Eigen/Core>
#include <vector>

#include "capture/rig.hpp"
#include "fit/depth_pull.hpp"
#include "fit/visibility.hpp"
#include "mesh/mesh.hpp"

namespace facet::fit {

/// The light that a blank slot's projectors give the skin: all the same even grey, near, with the shadows
/// that the mesh itself casts. A nose's shadow stays where it is while skin moves under it: flow that sees
/// it follows the shadow. One thread at a time.
class ProjectedLight {
 public:
  /// projectors: none where they are not known
  explicit ProjectedLight(std::vector<capture::Lens> projectors);

  /// The mesh that casts shadows from now on. [3][vertex_count] rig frame
  void cast_shadows(const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles);

  /// At a point of that mesh, rig frame, with its unit normal; 1 is one projector from the front, 1 m
  /// away, 0 full shadow. All are taken to be equally strong.
  float at(const Eigen::Vector3f& point_mm, const Eigen::Vector3f& normal) const;

  bool is_known() const { return !projectors_.empty(); }

 private:
  struct Projector {
    capture::Lens lens;
    Pinhole pinhole;
    Eigen::Vector3f centre_mm;
    DepthBuffer seen;
  };
  std::vector<Projector> projectors_;
};

}  // namespace facet::fit
