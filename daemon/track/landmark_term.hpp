#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "landmark/landmarker.hpp"
#include "track/camera_pose.hpp"
#include "track/further_camera.hpp"
#include "track/landmark_model.hpp"
#include "track/normal_equations.hpp"

namespace facet::track {

/// How far landmarks are trusted. Found by experiment: docs/decisions/tracking-weights.md.
struct LandmarkTrust {
  /// Standard deviation of one landmark on the face, mm.
  double sigma_mm = 1.2;
  /// How many independent measurements all landmarks of a group are worth together, in the order of
  /// LandmarkGroup: the net's errors are strongly correlated, so four hundred points are not four hundred
  /// facts.
  std::array<double, landmark::kLandmarkGroupCount> group_strength = {16, 6, 8, 48, 24, 12};
  /// The same for both irises together. Next to them only the gaze is free to answer.
  double iris_strength = 32;
  /// Contour points count this much along the outline, as a fraction of their weight across it.
  double along_contour = 0.1;
  /// Fraction of its weight left to a landmark that is not seen (FaceLandmarks::confidence 0).
  double unseen = 0.05;
  /// From this many standard deviations on, a residual counts linearly [Hub64].
  double huber_sigmas = 2.5;
};

/// What is solved for in each frame.
struct FrameState {
  Pose pose;
  Eigen::VectorXd expression;  ///< [expression_count] 0 to 1
};

/// Order of the unknowns of one frame: rotation increment (camera_from_head <- exp(increment) *
/// camera_from_head), translation, expression.
inline constexpr int kRotationAt = 0;
inline constexpr int kTranslationAt = 3;
inline constexpr int kExpressionAt = 6;

/// Moves `from` by `step` [6 + expression_count]; expressions are clamped to [0, 1].
void apply_step(const FrameState& from, const Eigen::VectorXd& step, FrameState& to);

/// The landmarks measured in one view of a frame, ready to be compared with the model's.
struct Observation {
  Eigen::Matrix2Xd points_px;              ///< [2][LandmarkModel::count()]
  std::vector<Eigen::Matrix2d> whitening;  ///< [count] residual in standard deviations = whitening * px
  FitCamera camera;
  bool seen = true;   ///< false: this view shows no face that can be believed; it says nothing
  double weight = 1;  ///< of its data term, see weigh_views
};

/// Takes the model's landmarks out of a whole face mesh and sets their whitening for a head at `place_mm` of
/// the reference camera's frame: sigma in pixels, group strength, confidence, contour anisotropy. focal_px:
/// of the reference camera; camera: the one that measured. Resizes `out` at its first use only.
void observe(const LandmarkModel& model, const LandmarkTrust& trust, const landmark::FaceLandmarks& face,
             const Eigen::Vector3d& place_mm, double focal_px, const FitCamera& camera, Observation& out);

/// Gives the seen views of a frame equal weights that sum to 1. The net errs on one face much alike from
/// every side: more views say where the face is, but make its shape and expression no more certain against
/// the priors.
void weigh_views(std::span<Observation> views);

/// The data term of the coarse fit in one view, V its view_from_reference; 0 where Observation::seen is
/// false:
///   E_data = weight / 2 sum_l rho(|| W_l (project(V (R (n_l + D_l e) + t)) - m_l) ||^2)
/// with rho = Huber and focal_px the reference camera's focal length, minimised by iteratively reweighted
/// Gauss-Newton steps. Holds scratch only; one thread.
class LandmarkTerm {
 public:
  LandmarkTerm(const LandmarkModel& model, const LandmarkTrust& trust);

  /// E_data; infinite where a landmark lies behind the camera.
  double energy(const LandmarkBasis& basis, const Observation& observation, double focal_px,
                const FrameState& state);

  /// Adds the rows of J and their residuals for the frame's own unknowns; when `by_identity_mm` is given
  /// (LandmarkModel::contract_expression at the state's expression), also for the shared unknowns that follow
  /// them: identity [identity_count], then log focal length. Returns E_data, infinite (and nothing added)
  /// where a landmark lies behind the camera.
  double linearise(
      const LandmarkBasis& basis, const Observation& observation, double focal_px, const FrameState& state,
      const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>* by_identity_mm,
      NormalEquations& equations);

  /// Distances of the projected landmarks from the measured ones at a state, px, [2][count]: with the basis'
  /// bias as the fit sees them, or without it as the mesh lies in the image. False where a landmark lies
  /// behind the camera.
  bool residuals_px(const LandmarkBasis& basis, const Observation& observation, double focal_px,
                    const FrameState& state, bool with_bias, Eigen::Matrix2Xd& out);

 private:
  void place(const LandmarkBasis& basis, const FrameState& state, bool with_bias);
  /// Of a placed landmark; false where it lies behind the camera.
  bool project_landmark(Eigen::Index l, const FitCamera& camera, double focal_px, const FrameState& state,
                        Projection& at) const;

  double huber_sigmas_;
  Eigen::VectorXd head_mm_;      ///< [count][3] landmarks in the head frame
  Eigen::Matrix3Xd rotated_mm_;  ///< [3][count] turned into the reference camera's axes
};

}  // namespace facet::track
