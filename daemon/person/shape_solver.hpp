#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "face/face_model.hpp"
#include "person/surface_anchor.hpp"

namespace facet::person {

/// A head as one keyframe has it.
struct HeadState {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();  ///< camera from head
  Eigen::Vector3d translation_mm{0, 0, 0};
  Eigen::VectorXd expression;  ///< [expression_count]
};

/// Where a keyframe's picture shows the skin, as the flow found it.
struct SkinPoints {
  Eigen::Matrix2Xd measured_px;   ///< [2][vertex_count]
  std::vector<float> confidence;  ///< [vertex_count] 0: nothing is known
};

/// The bundle adjustment over a turning head: neutral shape, focal length and the head's pose in every
/// keyframe from where the skin was seen,
///   E = sum_kv c_kv rho(|pi_f(R_k (X_v + sum_j e_kj D_jv) + t_k) - m_kv|) + E_anchor + ((ln f - ln f_0) /
///   sigma)^2 / 2 X = P (N0 + B y) + delta,  E_anchor = |y|^2 / 2 + sum_v a_v (lambda_0 |delta_v|^2 +
///   lambda_L |(L delta)_v|^2) / 2
/// by Gauss-Newton: the shape's sparse part is factorised, what all vertices share (y, poses, f) follows from
/// its Schur complement. P takes control vertices to where they lie on the subdivided surface, for that is
/// what pictures show; B are the model's identity modes, L its cotangent Laplacian. One thread.
class ShapeSolver {
 public:
  /// model      must outlive the solver
  /// identity   [identity_count] where the solve starts: N0
  /// focal_px   likewise; centre_px: of the picture
  /// focal_is_known  it is then held
  ShapeSolver(const face::FaceModel& model, const std::vector<float>& identity, double focal_px,
              const Eigen::Vector2d& centre_px, bool focal_is_known, const AnchorStrength& strength = {});
  ~ShapeSolver();

  /// What the keyframes measured; those with solves[k] == 0 tell nothing of the shape (they judge it).
  void set_points(std::vector<SkinPoints> points, const std::vector<char>& solves);
  std::vector<HeadState>& heads();
  const std::vector<HeadState>& heads() const;

  /// Gauss-Newton steps over poses, and where asked over shape and focal length. first: the focal length is
  /// held tighter. False where the system could not be solved; the state is then the one before.
  bool bundle(int steps, bool shape, bool first);
  /// Pose of one keyframe, and where asked its expression about `prior`, with the shape held.
  void resect(std::size_t keyframe, int steps, const Eigen::VectorXd* prior);
  /// Puts the shape that the solve started with, or back the one found, in its place.
  void use_generic(bool generic);

  /// [3][vertex_count] the surface's points of an expression in the head frame, mm.
  Eigen::Matrix3Xd surface(const Eigen::VectorXd& expression) const;
  /// Median distance of the surface from what a keyframe measured, px; NaN where less than 50 points count.
  double residual_px(std::size_t keyframe) const;
  /// [vertex_count] distance of each measured point, px; NaN where it does not count.
  Eigen::VectorXd residuals_px(std::size_t keyframe) const;
  /// Sets a measurement's standard deviation from the residuals of the keyframes that solve, 0.2 to 1 px.
  void measure_noise();
  double noise_px() const;
  /// Points that lie further off than three standard deviations and this count for little. Wide at first:
  /// a nose that the generic face lacks lies far off, and is no outlier.
  void set_least_bound_px(double bound);

  double focal_px() const;
  double generic_focal_px() const;
  /// [3][vertex_count] control vertices, mm: as the solve has them, and moved and scaled to lie nearest to
  /// the generic face (one camera does not know a head's size).
  Eigen::Matrix3Xd control() const;
  Eigen::Matrix3Xd control_in_gauge() const;
  const Eigen::Matrix3Xd& generic_control() const;
  /// |y| / sqrt(identity_count), and the 95th percentile of |delta| over the face, mm.
  double identity_distance() const;
  double offset_mm() const;
  /// Standard deviation of each vertex along its normal, mm, with poses and focal length unknown; NaN where
  /// the vertex is held. After bundle(). Seconds; go_on is asked all the while, and where it says no the rest
  /// is not known.
  Eigen::VectorXd uncertainty_mm(const std::function<bool()>& go_on);

  /// [n] the vertices that pictures tell of.
  const std::vector<std::int32_t>& skin() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::person
