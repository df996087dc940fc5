#pragma once

#include <Eigen/Geometry>

#include "facet/frame.hpp"

namespace facet::track {

/// A calibrated camera beside the reference camera, in whose frame everything is solved.
struct FurtherCamera {
  CameraIntrinsics intrinsics;
  Eigen::Isometry3d view_from_reference = Eigen::Isometry3d::Identity();  ///< mm
};

/// What a fit needs of a camera. The reference camera itself is the default.
struct FitCamera {
  Eigen::Vector2d centre_px{0, 0};  ///< principal point
  /// Focal length as a multiple of the reference camera's.
  double focal_ratio = 1;
  Eigen::Isometry3d view_from_reference = Eigen::Isometry3d::Identity();  ///< mm
};

}  // namespace facet::track
