#include "person/skin_motion.hpp"

#include <Eigen/Cholesky>
#include <algorithm>

namespace facet::person {
namespace {

/// A face's skin counts as so many independent facts, less of it as less.
constexpr float kFacts = 100;
constexpr float kUsuallyTold = 0.2F;  ///< of what a face could tell
/// What each of them errs by.
constexpr float kErrorMm = 0.35F;
constexpr float kErrorPx = 0.7F;
/// Errors, from which on a point loses its say.
constexpr float kBound = 2;
/// What a tracker errs by.
constexpr float kShiftMm = 3;
constexpr float kDepthMm = 1;
constexpr float kTurn = 0.05F;
constexpr int kRounds = 4;

}  // namespace

Eigen::Isometry3f isometry(const Motion& motion) {
  Eigen::Isometry3f out = Eigen::Isometry3f::Identity();
  const float angle = motion.head<3>().norm();
  if (angle > 0) {
    out.linear() = Eigen::AngleAxisf(angle, motion.head<3>() / angle).toRotationMatrix();
  }
  out.translation() = motion.tail<3>();
  return out;
}

Motion motion(const Eigen::Isometry3f& isometry) {
  const Eigen::AngleAxisf turn(isometry.linear());
  Motion out;
  out << turn.angle() * turn.axis(), isometry.translation();
  return out;
}

Eigen::Isometry3f motion_of(const SeenSkin& skin, const CameraIntrinsics& camera) {
  const Eigen::Index count = skin.weight.size();
  const float told = skin.weight.sum();
  if (!(told > 0)) {
    return Eigen::Isometry3f::Identity();
  }
  // About the skin's middle.
  const Eigen::Vector3f middle = skin.tracked_mm * skin.weight / told;
  Eigen::Matrix<float, 6, Eigen::Dynamic> columns(6, 2 * count);
  Eigen::VectorXf wanted_mm(2 * count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Eigen::Vector3f at = skin.tracked_mm.col(i);
    const Eigen::Vector3f seen = skin.seen_mm.col(i);
    Eigen::Matrix<float, 2, 3> in_picture;
    in_picture << 1, 0, -at.x() / at.z(), 0, 1, -at.y() / at.z();
    wanted_mm.segment<2>(2 * i) = at.z() * (seen.head<2>() / seen.z() - at.head<2>() / at.z());
    for (Eigen::Index k = 0; k < 2; ++k) {
      const Eigen::Vector3f across = in_picture.row(k);
      columns.col(2 * i + k) << (at - middle).cross(across), across;
    }
  }
  const float error_mm = kErrorMm + kErrorPx * middle.z() / camera.fx;
  const float facts = kFacts * std::min(1.0F, told / (kUsuallyTold * std::max(skin.whole, told)));
  Motion sigma;
  sigma << kTurn, kTurn, kTurn, kShiftMm, kShiftMm, kDepthMm;
  Motion found = Motion::Zero();
  for (int round = 0; round < kRounds; ++round) {
    Eigen::Matrix<float, 6, 6> matrix = sigma.cwiseAbs2().cwiseInverse().asDiagonal();
    Motion right = Motion::Zero();
    for (Eigen::Index i = 0; i < count; ++i) {
      const auto rows = columns.middleCols<2>(2 * i);
      const Eigen::Vector2f wanted = wanted_mm.segment<2>(2 * i);
      const float q =
          (rows.transpose() * found - wanted).squaredNorm() / (kBound * kBound * error_mm * error_mm);
      const float weight = facts * skin.weight[i] / (told * error_mm * error_mm * (1 + q) * (1 + q));
      matrix += weight * rows * rows.transpose();
      right += weight * rows * wanted;
    }
    found = matrix.ldlt().solve(right);
  }
  if (!found.allFinite()) {
    return Eigen::Isometry3f::Identity();
  }
  Eigen::Isometry3f out = isometry(found);
  out.translation() += middle - out.linear() * middle;
  return out;
}

}  // namespace facet::person
