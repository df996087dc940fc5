#pragma once

// Private to this room: what of a flow of the skin is the head's own movement.

#include <Eigen/Geometry>

#include "facet/frame.hpp"

namespace facet::person {

/// Where skin was tracked and is seen, and how much that counts.
struct SeenSkin {
  Eigen::Matrix3Xf tracked_mm;  ///< [3][points] camera frame
  Eigen::Matrix3Xf seen_mm;     ///< [3][points] camera frame: a point of the tracked surface
  Eigen::VectorXf weight;       ///< [points] 0 to 1
};

/// How a head has to move, in the camera's frame, for its skin to be where it is seen: robust least squares
/// of distances in the picture's plane, with what a landmark tracker usually errs by as the prior.
Eigen::Isometry3f motion_of(const SeenSkin& skin, const CameraIntrinsics& camera);

}  // namespace facet::person
