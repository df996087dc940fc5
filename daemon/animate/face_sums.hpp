#pragma once

#include <Eigen/Core>

#include "animate/take_basis.hpp"

namespace facet::animate {

/// The weighted sums over all captured faces that a control point's solution is made of, [SF04 eq. 17] and on
/// screen [SF04 eq. 21], with the row of ones eliminated: w_f = (1 / (1 + |s_f - p|)) / their sum.
///
/// A weight depends on nothing of a face but where it has the control point, so that in a long take faces
/// which have it in all but the same place can be summed beforehand. Above kMostFaces faces (and for at most
/// three numbers s_f) they are gathered on the nodes x_j of a lattice along the principal axes of s_f, each
/// on the corners N_j of its cell, and the proximity is interpolated linearly between nodes:
///   1 / (1 + |s_f - p|)  ~  sum_j N_j(s_f) / (1 + |x_j - p|).
/// The weights that follow are positive and sum to 1, as the exact ones do, and every sum uses the same ones.
/// What [SF04 eq. 17] promises of weighted sums and control points holds with them as well. They differ from
/// the exact ones where proximity is not linear within a cell, which is next to p; docs/animation.md says how
/// far the faces then differ.
///
/// Immutable; any thread.
class FaceSums {
 public:
  /// captured      [1 or more][frame_count] s_f, mm or px
  /// coefficients  [coefficient_count][frame_count] y_f; must live as long as this
  /// exact         sum over the faces themselves, however many they are
  FaceSums(Eigen::MatrixXd captured, const TakeBasis::MatrixView& coefficients, bool exact);

  struct Result {
    Eigen::VectorXd mean;        ///< m = sum w_f s_f
    Eigen::MatrixXd covariance;  ///< sum w_f (s_f - m)(s_f - m)^T
    Eigen::VectorXf average;     ///< [coefficient_count] sum w_f y_f
    Eigen::MatrixXf moments;     ///< [coefficient_count][of s_f] sum w_f y_f (s_f - m)^T
  };
  /// For a control point at p, finite.
  Result at(const Eigen::VectorXd& p) const;

  /// w_f themselves, for tests and pictures. [frame_count]
  Eigen::VectorXd weights(const Eigen::VectorXd& p) const;

  const Eigen::MatrixXd& captured() const { return captured_; }
  bool is_gathered() const { return nodes_.cols() > 0; }

  static constexpr Eigen::Index kMostNodes = 4096;
  /// More faces than these are gathered on nodes. A node costs as much time as a face: with fewer faces
  /// nothing would be gained.
  static constexpr Eigen::Index kMostFaces = kMostNodes;

 private:
  bool find_nodes(double spacing);
  void gather();
  Eigen::VectorXd node_weights(const Eigen::VectorXd& p) const;

  Eigen::MatrixXd captured_;
  TakeBasis::MatrixView coefficients_;
  Eigen::VectorXd origin_;  ///< mean of s_f
  Eigen::MatrixXd axes_;    ///< principal, columns
  // Filled where faces are gathered. Of its cell's two ends along axis a, corner c is at the upper one where
  // bit a of c is 1.
  Eigen::MatrixXi corners_;         ///< [2^dimensions][frame_count] nodes
  Eigen::MatrixXf shares_;          ///< [2^dimensions][frame_count] N_j(s_f)
  Eigen::MatrixXd nodes_;           ///< [dimensions][node count] along the axes
  Eigen::VectorXd counts_;          ///< [node count] sum over faces of N_j
  Eigen::MatrixXd first_moments_;   ///< [dimensions][node count] of s_f along the axes
  Eigen::MatrixXd second_moments_;  ///< [dimensions^2][node count]
  /// [(1 + dimensions) * coefficient_count][node count] First the sum over faces of N_j y_f; then, for each
  /// axis, the sum of N_j y_f times where s_f lies along that axis.
  Eigen::MatrixXf node_sums_;
};

}  // namespace facet::animate
