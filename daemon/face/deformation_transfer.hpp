#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::face {

/// Deformation transfer [SP04] between meshes of one topology: what each triangle of the
/// source goes through, the same triangle of the target goes through. Solved as
/// [BSPG06] show it to be: a Poisson equation over the target with its cotangent Laplacian, factorised once
/// per target.
class DeformationTransfer {
 public:
  /// source, target    [3][vertex_count] rest shapes
  /// triangles         [3][triangle_count]
  /// fixed             [vertex_count] 1: the vertex keeps its place in every deformation. Every connected
  /// part of
  ///                   the mesh needs at least one. Throws Error(Internal) where the system is singular.
  DeformationTransfer(const Eigen::Matrix3Xd& source, const Eigen::Matrix3Xd& target,
                      const mesh::Triangles& triangles, const std::vector<std::uint8_t>& fixed);
  ~DeformationTransfer();
  DeformationTransfer(DeformationTransfer&&) noexcept;

  /// The target's displacements for the source's displacements, both [3][vertex_count]. One thread per
  /// object.
  Eigen::Matrix3Xd transfer(const Eigen::Matrix3Xd& source_displacements) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The affine map that takes one triangle and its normal to another ([SP04 eq. 4]: the fourth
/// vertex stands on the first, along the normal scaled by the root of twice the area). Columns a, b, c are
/// corners.
Eigen::Matrix3d deformation_gradient(const Eigen::Matrix3d& rest_corners,
                                     const Eigen::Matrix3d& deformed_corners);

}  // namespace facet::face
