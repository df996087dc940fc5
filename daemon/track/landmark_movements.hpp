#pragma once

#include <Eigen/Core>

namespace facet::track {

/// How far landmarks have moved from the person's face at rest in the head frame, to the subject's left and
/// up: where the fit has them, and from there to where one view shows them, at their own distance. What is
/// not seen, and what lies further off than an expression brings it, is where the fit has it.
struct LandmarkMovements {
  Eigen::Matrix2Xf mm;   ///< [2][landmark model's count]
  Eigen::VectorXf seen;  ///< [landmark model's count] 0 to 1: how far the view tells of each
};

}  // namespace facet::track
