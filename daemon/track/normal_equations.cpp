#include "track/normal_equations.hpp"

#include <Eigen/Cholesky>
#include <algorithm>

namespace facet::track {

NormalEquations::NormalEquations(int unknown_count)
    : hessian(Eigen::MatrixXd::Zero(unknown_count, unknown_count)),
      gradient(Eigen::VectorXd::Zero(unknown_count)),
      unknown_count_(unknown_count),
      stride_((unknown_count + 3) / 4 * 4),
      panel_(static_cast<std::size_t>(kPanelRows) * static_cast<std::size_t>(stride_), 0.0) {}

void NormalEquations::clear() {
  hessian.setZero();
  gradient.setZero();
  waiting_ = 0;
}

double* NormalEquations::add_row(double residual) {
  if (waiting_ == kPanelRows) {
    add_panel();
  }
  const auto slot = static_cast<std::size_t>(waiting_);
  residuals_[slot] = residual;
  double* row = panel_.data() + slot * static_cast<std::size_t>(stride_);
  std::fill_n(row, stride_, 0.0);
  ++waiting_;
  return row;
}

void NormalEquations::add_panel() {
  const double* rows[kPanelRows];
  for (int r = 0; r < kPanelRows; ++r) {
    double* row = panel_.data() + static_cast<std::ptrdiff_t>(r) * stride_;
    if (r >= waiting_) {
      std::fill_n(row, stride_, 0.0);
      residuals_[static_cast<std::size_t>(r)] = 0.0;
    }
    rows[r] = row;
  }
  for (int i = 0; i < unknown_count_; ++i) {
    const double a0 = rows[0][i], a1 = rows[1][i], a2 = rows[2][i], a3 = rows[3][i];
    const double a4 = rows[4][i], a5 = rows[5][i], a6 = rows[6][i], a7 = rows[7][i];
    // The panel and the sums never overlap; without `restrict` the loop is not vectorised.
    double* __restrict column = hessian.data() + static_cast<std::ptrdiff_t>(i) * unknown_count_;
    const double* __restrict r0 = rows[0], * __restrict r1 = rows[1], * __restrict r2 = rows[2];
    const double* __restrict r3 = rows[3], * __restrict r4 = rows[4], * __restrict r5 = rows[5];
    const double* __restrict r6 = rows[6], * __restrict r7 = rows[7];
    for (int j = i; j < unknown_count_; ++j) {
      column[j] += ((a0 * r0[j] + a1 * r1[j]) + (a2 * r2[j] + a3 * r3[j])) +
                   ((a4 * r4[j] + a5 * r5[j]) + (a6 * r6[j] + a7 * r7[j]));
    }
    gradient[i] += ((a0 * residuals_[0] + a1 * residuals_[1]) + (a2 * residuals_[2] + a3 * residuals_[3])) +
                   ((a4 * residuals_[4] + a5 * residuals_[5]) + (a6 * residuals_[6] + a7 * residuals_[7]));
  }
  waiting_ = 0;
}

void NormalEquations::finish() {
  if (waiting_ > 0) {
    add_panel();
  }
  for (int i = 0; i < unknown_count_; ++i) {
    for (int j = i + 1; j < unknown_count_; ++j) {
      hessian(i, j) = hessian(j, i);
    }
  }
}

bool solve_bounded_step(const Eigen::MatrixXd& hessian, const Eigen::VectorXd& gradient, double damping,
                        BoundedStepScratch& scratch, Eigen::VectorXd& step) {
  // Keeps an unknown that nothing observes (diagonal 0) solvable: it then gets step 0.
  constexpr double kTinyDiagonal = 1e-9;
  scratch.damped = hessian;
  const Eigen::Index count = gradient.size();
  for (Eigen::Index i = 0; i < count; ++i) {
    scratch.damped(i, i) += damping * hessian(i, i) + kTinyDiagonal;
    scratch.right_hand_side[i] = -gradient[i];
    if (scratch.held[static_cast<std::size_t>(i)] != 0) {
      scratch.damped.row(i).setZero();
      scratch.damped.col(i).setZero();
      scratch.damped(i, i) = 1.0;
      scratch.right_hand_side[i] = 0.0;
    }
  }
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> cholesky(scratch.damped);
  if (cholesky.info() != Eigen::Success) {
    return false;
  }
  step = scratch.right_hand_side;
  cholesky.solveInPlace(step);
  return step.allFinite();
}

}  // namespace facet::track
