#pragma once

#include <Eigen/Core>

#include "animate/take_basis.hpp"

namespace facet::animate {

/// The distance between two faces of a take over one soft region, through the reduced basis: the root mean
/// square over the region's vertices of how far they are apart, mm (dist of [SF04 eq. 23] with
/// the weights of [SF04 sec. 5.2.1], per vertex instead of summed). Measured on the control vertices, the
/// displacements and the eyeballs; it neglects that normals turn. Immutable; any thread.
class RegionMetric {
 public:
  /// control_weights [control_count], finest_weights [finest_count], eye_weights [eye_count]: how much each
  /// vertex and eyeball counts, 0 to 1.
  RegionMetric(const TakeBasis& basis, const Eigen::VectorXf& control_weights,
               const Eigen::VectorXf& finest_weights, const Eigen::VectorXf& eye_weights);
  /// Every vertex counts the same.
  explicit RegionMetric(const TakeBasis& basis);

  /// Brings faces into a space in which the Euclidean distance of two of them is the metric's, mm. One column
  /// per face.
  ///
  /// coefficients  [expression_offset or more][face_count] of TakeBasis in their order; what comes after the
  ///               eyes is not looked at
  /// returns       [expression_offset][face_count] mm
  Eigen::MatrixXf coordinates(const Eigen::Ref<const Eigen::MatrixXf>& coefficients) const {
    return transform_ * coefficients.topRows(transform_.cols());
  }

 private:
  Eigen::MatrixXf transform_;  ///< [expression_offset][expression_offset]
};

}  // namespace facet::animate
