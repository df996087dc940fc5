#pragma once

#include <Eigen/Core>

namespace facet::maths {

/// to = scale * rotation * from + translation.
struct Similarity {
  float scale = 1;
  Eigen::Matrix3f rotation = Eigen::Matrix3f::Identity();
  Eigen::Vector3f translation_mm{0, 0, 0};

  Eigen::Vector3f operator*(const Eigen::Vector3f& point_mm) const {
    return scale * (rotation * point_mm) + translation_mm;
  }
  Eigen::Matrix3Xf apply(const Eigen::Matrix3Xf& points_mm) const {
    return ((scale * rotation) * points_mm).colwise() + translation_mm;
  }
};

/// The similarity (with_scale) or rigid motion that brings pairs of points together in the least squares
/// sense [Ume91]. from_mm, to_mm [3][point_count], the same count, 3 or more that do not lie on a
/// line; fewer give the identity.
Similarity best_similarity(const Eigen::Matrix3Xf& from_mm, const Eigen::Matrix3Xf& to_mm, bool with_scale);

}  // namespace facet::maths
