#pragma once

#include <Eigen/Geometry>
#include <array>
#include <string>
#include <vector>

#include "capture/rig.hpp"

namespace facet::calibration {

/// One board corner in one picture.
struct CornerObservation {
  std::size_t camera = 0;
  std::size_t view = 0;
  Eigen::Vector3d board_mm;  ///< where the corner is on the board
  Eigen::Vector2d px;
};

/// Cameras that look at a board which is moved: view v has one pose of the board, all cameras see it at once.
/// Lens::camera_from_rig is camera_from_world; the first camera's stays as it is.
struct BundleProblem {
  std::vector<capture::Lens> lenses;
  std::vector<Eigen::Isometry3d> world_from_board;  ///< [view_count]
  std::vector<CornerObservation> observations;
};

struct BundleOptions {
  int most_steps = 100;
  double huber_px = 1;          ///< errors beyond it count linearly
  bool free_intrinsics = true;  ///< false: poses alone
  bool free_k3 = false;         ///< else it stays as it is
};

/// fx, fy, cx, cy, k1, k2, p1, p2, k3 of a lens, in this order.
inline constexpr int kIntrinsicCount = 9;

enum class BundleOutcome { Converged, NotConverged, NumericalFailure };

struct BundleResult {
  BundleOutcome outcome = BundleOutcome::NumericalFailure;
  int steps = 0;
  double rms_px = 0;    ///< over all observations: sqrt(mean of dx^2 + dy^2)
  double sigma_px = 0;  ///< of one coordinate, the unknowns' share of freedom taken off
  /// Standard deviation of each camera's intrinsics under noise of sigma_px; infinite where the views do not
  /// tell; 0 where held.
  std::vector<std::array<double, kIntrinsicCount>> intrinsic_sigma;
  std::string message;  ///< one sentence with the numbers
};

/// Reprojection error of one observation, px; and its derivatives by intrinsics, camera pose and board pose
/// (turn then shift, applied on the left in the camera's and in the world's frame). NaN where the corner lies
/// behind the camera. The derivatives may be null.
Eigen::Vector2d residual_px(const BundleProblem& problem, const CornerObservation& observation,
                            Eigen::Matrix<double, 2, kIntrinsicCount>* by_intrinsics,
                            Eigen::Matrix<double, 2, 6>* by_camera, Eigen::Matrix<double, 2, 6>* by_board);

/// Minimises the sum of Huber's function of the reprojection errors over intrinsics, camera poses and board
/// poses: Levenberg [Lev44] and Marquardt [Mar63], the board poses eliminated (Schur complement
/// [TMHF00 sec. 6]). Changes the problem's lenses and poses.
BundleResult adjust(BundleProblem& problem, const BundleOptions& options);

/// What adjust() takes for a small turn (radians, axis times angle) and shift, as it applies it.
Eigen::Isometry3d moved(const Eigen::Isometry3d& pose,
                        const Eigen::Ref<const Eigen::Matrix<double, 6, 1>>& by);
/// The same for intrinsics.
void change_intrinsics(capture::Lens& lens,
                       const Eigen::Ref<const Eigen::Matrix<double, kIntrinsicCount, 1>>& by);

}  // namespace facet::calibration
