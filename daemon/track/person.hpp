#pragma once

#include <Eigen/Core>

namespace facet::track {

/// What the frames of one subject share.
struct SubjectShape {
  Eigen::VectorXd identity;  ///< [identity_count] standard deviations
  double focal_px = 0;       ///< for images of the size they were estimated from
};

/// What one subject keeps from frame to frame.
struct Person {
  SubjectShape shape;
  Eigen::VectorXd landmark_bias_mm;  ///< [LandmarkModel::count()][3] head frame, see IdentityFit
  /// Usual median residual of this subject's landmarks, as a fraction of the interocular distance; 0 before
  /// it is known. Another person's landmarks fit this identity worse.
  double usual_residual = 0;
};

}  // namespace facet::track
