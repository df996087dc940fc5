#pragma once

#include <Eigen/Core>
#include <optional>

namespace facet::track {

/// Where the head stands: p_camera = rotation * p_head + translation_mm. Camera frame: x right, y down, z
/// forward; head frame: x to the subject's left, y up, z out of the face.
struct Pose {
  /// camera_from_head, facing the camera.
  Eigen::Matrix3d rotation = Eigen::Vector3d(1, -1, -1).asDiagonal();
  Eigen::Vector3d translation_mm = Eigen::Vector3d(0, 0, 600);  ///< camera_from_head
};

/// Skew-symmetric matrix of v: cross_matrix(v) * p = v x p.
Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v);

/// Rodrigues: the rotation by |omega_rad| about omega_rad.
Eigen::Matrix3d rotation_from_vector(const Eigen::Vector3d& omega_rad);

/// Inverse of rotation_from_vector; the angle is in [0, pi].
Eigen::Vector3d vector_from_rotation(const Eigen::Matrix3d& rotation);

/// Inverse left Jacobian of SO(3): vector_from_rotation(rotation_from_vector(d) * Q) =
/// omega + left_jacobian_inverse(omega) * d + O(d^2), with omega = vector_from_rotation(Q). |omega_rad| < pi.
Eigen::Matrix3d left_jacobian_inverse(const Eigen::Vector3d& omega_rad);

/// A point in the image, with its derivatives.
struct Projection {
  Eigen::Vector2d px;
  Eigen::Matrix<double, 2, 3> by_point;  ///< by the point in the camera frame, px per mm
  Eigen::Vector2d by_log_focal;          ///< by the logarithm of the focal length, px
};

/// Nearest depth that a face point may have, mm: nearer, the projection says nothing.
inline constexpr double kNearestDepthMm = 20.0;

/// Pinhole projection with one focal length: px = focal_px * (x, y) / z + centre_px. False, and `out`
/// untouched, where the point is nearer than kNearestDepthMm or behind the camera.
bool project(const Eigen::Vector3d& point_camera_mm, double focal_px, const Eigen::Vector2d& centre_px,
             Projection& out);

/// Pose from points whose depth is known up to scale (weak perspective): the similarity that carries
/// points_head_mm to points_px in the least-squares sense [Ume91], its scale read as focal / distance.
///
/// points_head_mm  [3][n] head frame
/// points_px       [3][n] image x, image y, and depth in the same unit, growing away from the camera
/// weights         [n] >= 0
/// returns         nothing where the points are degenerate (all equal, collinear or not finite)
std::optional<Pose> pose_from_similarity(const Eigen::Matrix3Xd& points_head_mm,
                                         const Eigen::Matrix3Xd& points_px, const Eigen::VectorXd& weights,
                                         double focal_px, const Eigen::Vector2d& centre_px);

}  // namespace facet::track
