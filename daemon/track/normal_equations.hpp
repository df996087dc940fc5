#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace facet::track {

/// Sums J^T J and J^T r of a least-squares problem row by row, eight rows of J at a time so that the sums
/// stay in the first-level cache. Allocates only in the constructor. One thread.
class NormalEquations {
 public:
  explicit NormalEquations(int unknown_count);

  int unknown_count() const { return unknown_count_; }

  /// Forgets everything summed so far.
  void clear();

  /// The next row of J, [unknown_count], zeroed; its residual is `residual`. Valid until the next call of any
  /// member.
  double* add_row(double residual);

  /// Adds the rows still waiting and mirrors the lower triangle, so that hessian and gradient are complete.
  /// Terms that are no rows of J may be added to both afterwards.
  void finish();

  Eigen::MatrixXd hessian;   ///< [unknown_count][unknown_count] sum of J^T J
  Eigen::VectorXd gradient;  ///< [unknown_count] sum of J^T r

 private:
  static constexpr int kPanelRows = 8;

  void add_panel();

  int unknown_count_;
  int stride_;
  int waiting_ = 0;
  std::vector<double> panel_;  ///< [kPanelRows][stride_]
  std::array<double, kPanelRows> residuals_{};
};

/// Scratch of solve_bounded_step, allocated once.
struct BoundedStepScratch {
  explicit BoundedStepScratch(int unknown_count)
      : damped(unknown_count, unknown_count),
        right_hand_side(unknown_count),
        held(static_cast<std::size_t>(unknown_count)) {}

  Eigen::MatrixXd damped;
  Eigen::VectorXd right_hand_side;
  std::vector<char> held;  ///< [unknown_count] 1: the unknown rests on its bound in this step
};

/// One Levenberg-Marquardt step (H + damping * diag H) step = -g over the unknowns that are free ([Mar63],
/// with the active set of [Ber82]): an unknown for which scratch.held is 1 gets step 0. damping
/// >= 0. Returns false where the damped matrix is not positive definite or the step is not finite.
bool solve_bounded_step(const Eigen::MatrixXd& hessian, const Eigen::VectorXd& gradient, double damping,
                        BoundedStepScratch& scratch, Eigen::VectorXd& step);

}  // namespace facet::track
