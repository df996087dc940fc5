#pragma once

// Private to this room: what of a flow of the skin is the head's own movement.

#include <Eigen/Geometry>

#include "facet/frame.hpp"

namespace facet::person {

/// Of a rigid body about its frame's origin: rotation vector, then shift in mm.
using Motion = Eigen::Matrix<float, 6, 1>;
Eigen::Isometry3f isometry(const Motion& motion);
Motion motion(const Eigen::Isometry3f& isometry);

/// Where skin was tracked and is seen, and how much that counts.
struct SeenSkin {
  Eigen::Matrix3Xf tracked_mm;  ///< [3][points] camera frame
  Eigen::Matrix3Xf seen_mm;     ///< [3][points] camera frame: a point of the tracked surface
  Eigen::VectorXf weight;       ///< [points] 0 to 1
  float whole = 0;              ///< sum of the weights of a face of which everything tells what it can
};

/// How a head has to move, in the camera's frame, for its skin to be where it is seen: robust least squares
/// of distances in the picture's plane, with what a landmark tracker usually errs by as the prior. The depth,
/// which one picture hardly tells and a tracker calms, stays about as it is.
Eigen::Isometry3f motion_of(const SeenSkin& skin, const CameraIntrinsics& camera);

}  // namespace facet::person
