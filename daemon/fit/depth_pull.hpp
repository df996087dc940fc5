#pragma once

#include <Eigen/Core>
#include <optional>

#include "capture/depth_map.hpp"

namespace facet::fit {

/// Weight of Tukey's biweight: rho'(x) / x, 1 at 0, 0 beyond sigma.
inline float tukey_weight(float x, float sigma) {
  const float ratio = x / sigma;
  const float rest = 1 - ratio * ratio;
  return rest > 0 ? rest * rest : 0.0F;
}

/// A lens without its distortion, in single precision.
struct Pinhole {
  explicit Pinhole(const capture::Lens& lens);

  Eigen::Matrix3f rotation;     ///< camera from rig
  Eigen::Vector3f translation;  ///< mm
  float fx, fy, cx, cy;         ///< px
};

/// How a depth map pulls on a point of the template (one term of [SF04 eq. 10]).
struct DepthPull {
  float difference_mm = 0;  ///< along the map's z axis: the point's less the map's
  float facing = 0;         ///< cosine between the map's normal and the way to the camera, at least 0
  float alike = 0;          ///< cosine between the map's normal and the template's
  /// Confidence x max(0, normal . template normal) x facing^2 x Tukey's weight; 0 where turned away or
  /// farther off than sigma.
  float weight = 0;
  Eigen::Vector3f jacobian{0, 0, 0};  ///< of the difference by the point, rig frame
};

/// map       whose lens `camera` is
/// point_mm  rig frame
/// normal    of the template there, unit, rig frame
/// sigma_mm  Tukey's
/// returns   nothing where the map says nothing: outside, in a hole, across a break or a twist of its surface
std::optional<DepthPull> pull_of(const capture::DepthMap& map, const Pinhole& camera,
                                 const Eigen::Vector3f& point_mm, const Eigen::Vector3f& normal,
                                 float sigma_mm);

}  // namespace facet::fit
