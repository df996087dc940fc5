#include "track/camera_pose.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

namespace facet::track {
namespace {

/// Below this angle (rad) the series of the trigonometric quotients are exact to double precision.
constexpr double kSmallAngleRad = 1e-4;

}  // namespace

Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Eigen::Matrix3d rotation_from_vector(const Eigen::Vector3d& omega_rad) {
  const double angle = omega_rad.norm();
  const double squared = angle * angle;
  const double a = angle < kSmallAngleRad ? 1.0 - squared / 6.0 : std::sin(angle) / angle;
  const double b = angle < kSmallAngleRad ? 0.5 - squared / 24.0 : (1.0 - std::cos(angle)) / squared;
  const Eigen::Matrix3d w = cross_matrix(omega_rad);
  return Eigen::Matrix3d::Identity() + a * w + b * w * w;
}

Eigen::Vector3d vector_from_rotation(const Eigen::Matrix3d& rotation) {
  const Eigen::Quaterniond q(rotation);
  const Eigen::Vector3d axis = q.w() < 0 ? Eigen::Vector3d(-q.vec()) : Eigen::Vector3d(q.vec());
  const double sine = axis.norm();
  const double angle = 2.0 * std::atan2(sine, std::abs(q.w()));
  return sine < 0.5 * kSmallAngleRad ? Eigen::Vector3d(2.0 * axis) : Eigen::Vector3d(axis * (angle / sine));
}

Eigen::Matrix3d left_jacobian_inverse(const Eigen::Vector3d& omega_rad) {
  const double angle = omega_rad.norm();
  const double half = 0.5 * angle;
  const double c = angle < 1e-3 ? 1.0 / 12.0 : (1.0 - half / std::tan(half)) / (angle * angle);
  const Eigen::Matrix3d w = cross_matrix(omega_rad);
  return Eigen::Matrix3d::Identity() - 0.5 * w + c * w * w;
}

bool project(const Eigen::Vector3d& point_camera_mm, double focal_px, const Eigen::Vector2d& centre_px,
             Projection& out) {
  const double z = point_camera_mm.z();
  if (!(z >= kNearestDepthMm)) {
    return false;
  }
  const double scale = focal_px / z;
  const Eigen::Vector2d offset = scale * point_camera_mm.head<2>();
  out.px = offset + centre_px;
  out.by_point << scale, 0, -offset.x() / z, 0, scale, -offset.y() / z;
  out.by_log_focal = offset;
  return true;
}

std::optional<Pose> pose_from_similarity(const Eigen::Matrix3Xd& points_head_mm,
                                         const Eigen::Matrix3Xd& points_px, const Eigen::VectorXd& weights,
                                         double focal_px, const Eigen::Vector2d& centre_px) {
  const double total = weights.sum();
  if (!(total > 0) || !points_px.allFinite()) {
    return std::nullopt;
  }
  const Eigen::Vector3d mean_head = points_head_mm * weights / total;
  const Eigen::Vector3d mean_px = points_px * weights / total;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double spread_head = 0;
  double spread_px = 0;
  for (Eigen::Index i = 0; i < weights.size(); ++i) {
    const Eigen::Vector3d head = points_head_mm.col(i) - mean_head;
    const Eigen::Vector3d px = points_px.col(i) - mean_px;
    covariance += weights[i] * px * head.transpose();
    spread_head += weights[i] * head.squaredNorm();
    spread_px += weights[i] * px.squaredNorm();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d& singular = svd.singularValues();
  // The second singular value vanishes for collinear points, the first for coincident ones.
  constexpr double kDegenerate = 1e-6;
  if (!(spread_head > 0) || !(singular[1] > kDegenerate * std::sqrt(spread_head * spread_px)) ||
      !(spread_px > 0)) {
    return std::nullopt;
  }
  const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1.0 : 1.0;
  const Eigen::Vector3d signs(1, 1, sign);
  const double px_per_mm = signs.dot(singular) / spread_head;
  if (!(px_per_mm > 0)) {
    return std::nullopt;
  }
  Pose pose;
  pose.rotation = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  const double depth_mm = focal_px / px_per_mm;
  const Eigen::Vector3d mean_camera((mean_px.x() - centre_px.x()) / px_per_mm,
                                    (mean_px.y() - centre_px.y()) / px_per_mm, depth_mm);
  pose.translation_mm = mean_camera - pose.rotation * mean_head;
  return pose;
}

}  // namespace facet::track
