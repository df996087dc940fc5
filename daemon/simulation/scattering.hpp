#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::simulation {

/// One bell of a diffusion profile: what part of the light comes out how far away, by channel.
struct Bell {
  float variance_mm2 = 0;  ///< along the surface, of each axis
  Eigen::Vector3f weight{0, 0, 0};
};

/// Skin's own profile: six bells, together 1 in each channel [DL07 sec. 14.4.4].
const std::vector<Bell>& skin_profile();

/// Light that diffuses along a surface: the heat equation of the mesh's cotangent Laplacian, solved by one
/// Chebyshev series for all bells and channels at once [HVG11 sec. 6]. Distances are those of the mesh given,
/// at rest. Immutable; any thread.
class Scattering {
 public:
  Scattering(const mesh::Vertices& resting_mm, const mesh::Triangles& triangles);

  /// Spreads light among the active vertices; through their border nothing goes. The sum of light times
  /// vertex area is kept, channel by channel.
  /// active  [vertex_count]
  /// light   [3][vertex_count] in/out, linear RGB
  void diffuse(const std::vector<Bell>& profile, const std::vector<std::uint8_t>& active,
               Eigen::Matrix3Xf& light) const;

  /// [vertex_count] mm^2, as the diffusion counts it: no less than a share of what its edges need.
  const Eigen::VectorXf& areas_mm2() const { return areas_mm2_; }

 private:
  std::vector<std::int32_t> first_;  ///< [vertex_count + 1] into the two below
  std::vector<std::int32_t> neighbour_;
  std::vector<float> conductance_;  ///< [neighbour_.size()] symmetric
  Eigen::VectorXf areas_mm2_;
};

}  // namespace facet::simulation
