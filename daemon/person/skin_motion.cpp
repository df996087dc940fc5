#include "person/skin_motion.hpp"

namespace facet::person {
namespace {

/// A face's skin counts as so many independent facts.
constexpr float kFacts = 100;
/// What each of them errs by.
constexpr float kErrorMm = 0.35F;
constexpr float kErrorPx = 0.7F;
/// Errors, from which on a point loses its say.
constexpr float kBound = 2;
/// What a tracker errs by.
constexpr float kShiftMm = 3;
constexpr float kDepthMm = 10;
constexpr float kTurn = 0.05F;
constexpr int kRounds = 4;

Eigen::Matrix3f cross(const Eigen::Vector3f& v) {
  Eigen::Matrix3f out;
  out << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return out;
}

}  // namespace

Eigen::Isometry3f motion_of(const SeenSkin& skin, const CameraIntrinsics& camera) {
  using Vector6 = Eigen::Matrix<float, 6, 1>;
  const Eigen::Index count = skin.weight.size();
  const float told = skin.weight.sum();
  if (!(told > 0)) {
    return Eigen::Isometry3f::Identity();
  }
  // Unknowns: shift, then turn about the skin's middle.
  const Eigen::Vector3f middle = skin.tracked_mm.rowwise().mean();
  Eigen::Matrix<float, 6, Eigen::Dynamic> columns(6, 2 * count);
  Eigen::VectorXf wanted_mm(2 * count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Eigen::Vector3f at = skin.tracked_mm.col(i);
    const Eigen::Vector3f seen = skin.seen_mm.col(i);
    Eigen::Matrix<float, 2, 3> in_picture;
    in_picture << 1, 0, -at.x() / at.z(), 0, 1, -at.y() / at.z();
    wanted_mm.segment<2>(2 * i) = at.z() * (seen.head<2>() / seen.z() - at.head<2>() / at.z());
    columns.block<3, 2>(0, 2 * i) = in_picture.transpose();
    columns.block<3, 2>(3, 2 * i) = (-in_picture * cross(at - middle)).transpose();
  }
  const float error_mm = kErrorMm + kErrorPx * middle.z() / camera.fx;
  const Vector6 sigma(kShiftMm, kShiftMm, kDepthMm, kTurn, kTurn, kTurn);
  Vector6 found = Vector6::Zero();
  for (int round = 0; round < kRounds; ++round) {
    Eigen::Matrix<float, 6, 6> matrix = sigma.cwiseAbs2().cwiseInverse().asDiagonal();
    Vector6 right = Vector6::Zero();
    for (Eigen::Index i = 0; i < count; ++i) {
      const auto rows = columns.middleCols<2>(2 * i);
      const Eigen::Vector2f wanted = wanted_mm.segment<2>(2 * i);
      const float q =
          (rows.transpose() * found - wanted).squaredNorm() / (kBound * kBound * error_mm * error_mm);
      const float weight = kFacts * skin.weight[i] / (told * error_mm * error_mm * (1 + q) * (1 + q));
      matrix += weight * rows * rows.transpose();
      right += weight * rows * wanted;
    }
    found = matrix.ldlt().solve(right);
  }
  if (!found.allFinite()) {
    return Eigen::Isometry3f::Identity();
  }
  const float angle = found.tail<3>().norm();
  Eigen::Isometry3f out = Eigen::Isometry3f::Identity();
  if (angle > 0) {
    out.linear() = Eigen::AngleAxisf(angle, found.tail<3>() / angle).toRotationMatrix();
  }
  out.translation() = middle + found.head<3>() - out.linear() * middle;
  return out;
}

}  // namespace facet::person
