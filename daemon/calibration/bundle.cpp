#include "calibration/bundle.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>

#include "maths/solve.hpp"

namespace facet::calibration {
namespace {

constexpr int kPose = 6;
constexpr int kCamera = kIntrinsicCount + kPose;  // unknowns of a camera: intrinsics, then pose

using CameraBlock = Eigen::Matrix<double, kCamera, kCamera>;
using ViewBlock = Eigen::Matrix<double, kPose, kPose>;

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d matrix;
  matrix << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return matrix;
}

/// Huber's function of the squared error, and the weight that makes it a least-squares problem [Hub64].
double huber(double squared, double limit) {
  return squared <= limit * limit ? squared : 2 * limit * std::sqrt(squared) - limit * limit;
}
double huber_weight(double squared, double limit) {
  return squared <= limit * limit ? 1 : limit / std::sqrt(squared);
}

double cost_of(const BundleProblem& problem, double limit) {
  double cost = 0;
  for (const CornerObservation& observation : problem.observations) {
    cost += huber(residual_px(problem, observation, nullptr, nullptr, nullptr).squaredNorm(), limit);
  }
  return cost;
}

/// J^T W J and J^T W r: cameras dense, one block a view, and what couples them.
struct NormalEquations {
  Eigen::MatrixXd cameras;             // [15 C][15 C], block diagonal before the elimination
  Eigen::VectorXd camera_right;        // [15 C]
  std::vector<ViewBlock> views;        // [V]
  Eigen::MatrixXd view_right;          // [6][V]
  std::vector<Eigen::MatrixXd> mixed;  // [V] of [15 C][6]
};

NormalEquations assemble(const BundleProblem& problem, double limit) {
  const auto camera_rows = static_cast<Eigen::Index>(problem.lenses.size()) * kCamera;
  const auto view_count = problem.world_from_board.size();
  NormalEquations normal;
  normal.cameras = Eigen::MatrixXd::Zero(camera_rows, camera_rows);
  normal.camera_right = Eigen::VectorXd::Zero(camera_rows);
  normal.views.assign(view_count, ViewBlock::Zero());
  normal.view_right = Eigen::MatrixXd::Zero(kPose, static_cast<Eigen::Index>(view_count));
  normal.mixed.assign(view_count, Eigen::MatrixXd::Zero(camera_rows, kPose));
  Eigen::Matrix<double, 2, kIntrinsicCount> by_intrinsics;
  Eigen::Matrix<double, 2, kPose> by_camera;
  Eigen::Matrix<double, 2, kPose> by_board;
  for (const CornerObservation& observation : problem.observations) {
    const Eigen::Vector2d residual = residual_px(problem, observation, &by_intrinsics, &by_camera, &by_board);
    const double weight = huber_weight(residual.squaredNorm(), limit);
    Eigen::Matrix<double, 2, kCamera> by_all;
    by_all << by_intrinsics, by_camera;
    const auto row = static_cast<Eigen::Index>(observation.camera) * kCamera;
    normal.cameras.block<kCamera, kCamera>(row, row) += weight * by_all.transpose() * by_all;
    normal.camera_right.segment<kCamera>(row) += weight * by_all.transpose() * residual;
    normal.views[observation.view] += weight * by_board.transpose() * by_board;
    normal.view_right.col(static_cast<Eigen::Index>(observation.view)) +=
        weight * by_board.transpose() * residual;
    normal.mixed[observation.view].block<kCamera, kPose>(row, 0) += weight * by_all.transpose() * by_board;
  }
  return normal;
}

/// The camera unknowns that may change.
std::vector<Eigen::Index> free_unknowns(const BundleProblem& problem, const BundleOptions& options) {
  std::vector<Eigen::Index> free;
  for (std::size_t camera = 0; camera < problem.lenses.size(); ++camera) {
    for (int k = 0; k < kCamera; ++k) {
      const bool intrinsic = k < kIntrinsicCount;
      const bool is_k3 = k == kIntrinsicCount - 1;
      if (intrinsic ? options.free_intrinsics && (!is_k3 || options.free_k3) : camera > 0) {
        free.push_back(static_cast<Eigen::Index>(camera) * kCamera + k);
      }
    }
  }
  return free;
}

struct Step {
  Eigen::VectorXd cameras;  // [15 C]
  Eigen::MatrixXd views;    // [6][V]
};

/// The camera unknowns' system with the views eliminated; damped by lambda times the diagonal.
struct Reduced {
  Eigen::MatrixXd matrix;  // of the free unknowns
  Eigen::VectorXd right;
  std::vector<ViewBlock> view_inverse;
};

Reduced eliminate_views(const NormalEquations& normal, const std::vector<Eigen::Index>& free, double lambda) {
  Eigen::MatrixXd matrix = normal.cameras;
  matrix.diagonal() *= 1 + lambda;
  Eigen::VectorXd right = normal.camera_right;
  Reduced reduced;
  for (std::size_t view = 0; view < normal.views.size(); ++view) {
    ViewBlock block = normal.views[view];
    block.diagonal() *= 1 + lambda;
    const ViewBlock inverse = block.ldlt().solve(ViewBlock::Identity());
    reduced.view_inverse.push_back(inverse);
    const Eigen::MatrixXd coupled = normal.mixed[view] * inverse;
    matrix.noalias() -= coupled * normal.mixed[view].transpose();
    right.noalias() -= coupled * normal.view_right.col(static_cast<Eigen::Index>(view));
  }
  reduced.matrix = matrix(free, free);
  reduced.right = right(free);
  return reduced;
}

Step solve(const NormalEquations& normal, const std::vector<Eigen::Index>& free, double lambda) {
  const Reduced reduced = eliminate_views(normal, free, lambda);
  Step step{Eigen::VectorXd::Zero(normal.camera_right.size()), normal.view_right};
  if (!free.empty()) {
    // Pixels, distortion and radians differ by many orders: scaled to a unit diagonal before the solution.
    const Eigen::VectorXd scale = reduced.matrix.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    const Eigen::MatrixXd scaled = scale.asDiagonal() * reduced.matrix * scale.asDiagonal();
    step.cameras(free) =
        -(scale.asDiagonal() * maths::solve_symmetric(scaled, scale.asDiagonal() * reduced.right));
  }
  for (std::size_t view = 0; view < normal.views.size(); ++view) {
    const auto column = static_cast<Eigen::Index>(view);
    step.views.col(column) = -reduced.view_inverse[view] *
                             (normal.view_right.col(column) + normal.mixed[view].transpose() * step.cameras);
  }
  return step;
}

void apply(BundleProblem& problem, const Step& step) {
  for (std::size_t camera = 0; camera < problem.lenses.size(); ++camera) {
    const auto row = static_cast<Eigen::Index>(camera) * kCamera;
    change_intrinsics(problem.lenses[camera], step.cameras.segment<kIntrinsicCount>(row));
    Eigen::Isometry3d& pose = problem.lenses[camera].camera_from_rig;
    pose = moved(pose, step.cameras.segment<kPose>(row + kIntrinsicCount));
  }
  for (std::size_t view = 0; view < problem.world_from_board.size(); ++view) {
    Eigen::Isometry3d& pose = problem.world_from_board[view];
    pose = moved(pose, step.views.col(static_cast<Eigen::Index>(view)));
  }
}

/// Covariance of the free camera unknowns: sigma^2 times the inverse of the reduced system.
void fill_sigmas(const BundleProblem& problem, const BundleOptions& options, BundleResult& result) {
  const std::vector<Eigen::Index> free = free_unknowns(problem, options);
  const Reduced reduced = eliminate_views(assemble(problem, options.huber_px), free, 0);
  result.intrinsic_sigma.assign(problem.lenses.size(), {});
  if (free.empty()) {
    return;
  }
  const Eigen::VectorXd scale = reduced.matrix.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const maths::SymmetricEigen eigen =
      maths::symmetric_eigen(scale.asDiagonal() * reduced.matrix * scale.asDiagonal());
  const double floor = 1e-14 * eigen.values.maxCoeff();
  for (std::size_t i = 0; i < free.size(); ++i) {
    const auto camera = static_cast<std::size_t>(free[i] / kCamera);
    const auto which = static_cast<std::size_t>(free[i] % kCamera);
    if (which < kIntrinsicCount) {
      const auto row = static_cast<Eigen::Index>(i);
      const double variance =
          (eigen.vectors.row(row).array().square().transpose() / eigen.values.array().max(floor)).sum();
      result.intrinsic_sigma[camera].at(which) = result.sigma_px * scale[row] * std::sqrt(variance);
    }
  }
}

}  // namespace

Eigen::Isometry3d moved(const Eigen::Isometry3d& pose,
                        const Eigen::Ref<const Eigen::Matrix<double, 6, 1>>& by) {
  const Eigen::Vector3d turn = by.head<3>();
  const double angle = turn.norm();
  Eigen::Isometry3d change = Eigen::Isometry3d::Identity();
  if (angle > 0) {
    change.linear() = Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
  }
  change.translation() = by.tail<3>();
  Eigen::Isometry3d out = change * pose;
  // Many small turns do not add up to a skewed matrix.
  out.linear() = Eigen::Quaterniond(out.linear()).normalized().toRotationMatrix();
  return out;
}

void change_intrinsics(capture::Lens& lens,
                       const Eigen::Ref<const Eigen::Matrix<double, kIntrinsicCount, 1>>& by) {
  lens.fx_px += by[0];
  lens.fy_px += by[1];
  lens.cx_px += by[2];
  lens.cy_px += by[3];
  lens.distortion.k1 += by[4];
  lens.distortion.k2 += by[5];
  lens.distortion.p1 += by[6];
  lens.distortion.p2 += by[7];
  lens.distortion.k3 += by[8];
}

Eigen::Vector2d residual_px(const BundleProblem& problem, const CornerObservation& observation,
                            Eigen::Matrix<double, 2, kIntrinsicCount>* by_intrinsics,
                            Eigen::Matrix<double, 2, 6>* by_camera, Eigen::Matrix<double, 2, 6>* by_board) {
  const capture::Lens& lens = problem.lenses[observation.camera];
  const capture::LensDistortion& bent = lens.distortion;
  const Eigen::Vector3d world = problem.world_from_board[observation.view] * observation.board_mm;
  const Eigen::Vector3d seen = lens.camera_from_rig * world;
  if (!(seen.z() > 0)) {
    return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  // Brown's distortion (docs/rig-format.md) and its derivatives.
  const double x = seen.x() / seen.z();
  const double y = seen.y() / seen.z();
  const double r2 = x * x + y * y;
  const double radial = 1 + r2 * (bent.k1 + r2 * (bent.k2 + r2 * bent.k3));
  const double xd = x * radial + 2 * bent.p1 * x * y + bent.p2 * (r2 + 2 * x * x);
  const double yd = y * radial + bent.p1 * (r2 + 2 * y * y) + 2 * bent.p2 * x * y;
  if (by_intrinsics != nullptr) {
    const double fx = lens.fx_px;
    const double fy = lens.fy_px;
    *by_intrinsics << xd, 0, 1, 0, fx * x * r2, fx * x * r2 * r2, fx * 2 * x * y, fx * (r2 + 2 * x * x),
        fx * x * r2 * r2 * r2,  //
        0, yd, 0, 1, fy * y * r2, fy * y * r2 * r2, fy * (r2 + 2 * y * y), fy * 2 * x * y,
        fy * y * r2 * r2 * r2;
  }
  if (by_camera != nullptr && by_board != nullptr) {
    const double slope = 2 * (bent.k1 + r2 * (2 * bent.k2 + r2 * 3 * bent.k3));
    const double cross = slope * x * y + 2 * bent.p1 * x + 2 * bent.p2 * y;
    Eigen::Matrix2d by_normalised;
    by_normalised << lens.fx_px * (radial + slope * x * x + 2 * bent.p1 * y + 6 * bent.p2 * x),
        lens.fx_px * cross, lens.fy_px * cross,
        lens.fy_px * (radial + slope * y * y + 6 * bent.p1 * y + 2 * bent.p2 * x);
    Eigen::Matrix<double, 2, 3> by_direction;
    by_direction << 1 / seen.z(), 0, -x / seen.z(), 0, 1 / seen.z(), -y / seen.z();
    const Eigen::Matrix<double, 2, 3> by_seen = by_normalised * by_direction;
    // Turned by a small w and shifted by t, a point p goes to p + w x p + t.
    *by_camera << -by_seen * cross_matrix(seen), by_seen;
    const Eigen::Matrix<double, 2, 3> by_world = by_seen * lens.camera_from_rig.linear();
    *by_board << -by_world * cross_matrix(world), by_world;
  }
  return {lens.fx_px * xd + lens.cx_px - observation.px.x(),
          lens.fy_px * yd + lens.cy_px - observation.px.y()};
}

BundleResult adjust(BundleProblem& problem, const BundleOptions& options) {
  BundleResult result;
  const std::vector<Eigen::Index> free = free_unknowns(problem, options);
  double cost = cost_of(problem, options.huber_px);
  if (!std::isfinite(cost)) {
    result.message = "a corner lies behind its camera, or a number is not finite";
    return result;
  }
  result.outcome = BundleOutcome::NotConverged;
  double lambda = 1e-4;
  constexpr double kMostLambda = 1e12;
  while (result.steps < options.most_steps && result.outcome == BundleOutcome::NotConverged) {
    ++result.steps;
    const NormalEquations normal = assemble(problem, options.huber_px);
    for (;;) {
      BundleProblem changed{problem.lenses, problem.world_from_board, {}};
      apply(changed, solve(normal, free, lambda));
      changed.observations.swap(problem.observations);
      const double new_cost = cost_of(changed, options.huber_px);
      changed.observations.swap(problem.observations);
      if (std::isfinite(new_cost) && new_cost <= cost) {
        problem.lenses = std::move(changed.lenses);
        problem.world_from_board = std::move(changed.world_from_board);
        // Noise makes the cost flat at its bottom: 1e-10 of it is far below what any camera notices.
        if (cost - new_cost <= 1e-10 * cost) {
          result.outcome = BundleOutcome::Converged;
        }
        cost = new_cost;
        lambda = std::max(lambda / 10, 1e-12);
        break;
      }
      lambda *= 10;
      if (lambda > kMostLambda) {  // no direction leads down: this is the bottom
        result.outcome = BundleOutcome::Converged;
        break;
      }
    }
  }
  double squares = 0;
  for (const CornerObservation& observation : problem.observations) {
    squares += residual_px(problem, observation, nullptr, nullptr, nullptr).squaredNorm();
  }
  const auto count = static_cast<double>(problem.observations.size());
  const double unknowns =
      static_cast<double>(free.size()) + kPose * static_cast<double>(problem.world_from_board.size());
  result.rms_px = std::sqrt(squares / std::max(count, 1.0));
  result.sigma_px = std::sqrt(squares / std::max(2 * count - unknowns, 1.0));
  fill_sigmas(problem, options, result);
  result.message = fmt::format("{} after {} steps: {:.4f} px (rms) over {} corners",
                               result.outcome == BundleOutcome::Converged ? "converged" : "not converged",
                               result.steps, result.rms_px, problem.observations.size());
  return result;
}

}  // namespace facet::calibration
