#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "track/coarse_fit.hpp"
#include "track/person.hpp"

namespace facet::track {

/// Strengths of the priors on what a subject's frames share. Found by experiment:
/// docs/decisions/tracking-weights.md.
struct IdentityPriorStrength {
  /// Of |identity|^2 / 2 per frame. It grows with the number of frames because the landmark net's error on
  /// one face is much the same in every frame: more frames do not make the shape more certain.
  double identity = 2.5;
  /// Focal length over the longer image side: median and standard deviation of the logarithm. Webcams and
  /// phones see 50 to 75 degrees along it (0.13 either way); tighter than that because frontal faces hardly
  /// tell focal length from distance, and what they seem to tell is mostly how the face differs from the
  /// model.
  double focal_ratio = 0.87;
  double log_focal_sigma = 0.1;
  /// Frames whose worth a landmark's persistent offset needs before half of it is believed.
  double bias_frames = 2.0;
};

/// What something beside the landmarks says of an identity, to second order around `at`:
///   E(w_id) = 1/2 (w_id - at)^T information (w_id - at) - pull^T (w_id - at)
struct IdentityEvidence {
  Eigen::MatrixXd information;  ///< [identity_count][identity_count] positive semi-definite
  Eigen::VectorXd pull;         ///< [identity_count]
  Eigen::VectorXd at;           ///< [identity_count]
};

/// Estimates identity and focal length jointly over a batch of frames, each with its own pose and expression
/// [MD19 sec. 3; WSXC16]:
///   E = sum_f (sum_views E_data + E_expression) + n (identity/2 |w_id|^2 + 1/2 ((ln f - ln f_0) / sigma)^2)
/// by Levenberg-Marquardt; the frames' unknowns are eliminated by their Schur complement. Allocates with
/// every frame added, and not in `improve`. One thread.
class IdentityFit {
 public:
  /// longer_side_px: of the image. fixed_focal_px: 0 to estimate the focal length. cameras: one for each
  /// view, the reference camera first.
  IdentityFit(const LandmarkModel& model, const ExpressionPrior& prior, const LandmarkTrust& trust,
              const IdentityPriorStrength& strength, double longer_side_px, double fixed_focal_px,
              std::vector<FitCamera> cameras);

  /// Takes a frame into the batch. faces: of each view, null where it shows none that counts; at least one is
  /// there. `start` is the frame's pose and expression so far.
  void add_frame(std::span<const landmark::FaceLandmarks* const> faces, const FrameState& start);

  /// What something else says of the identity, from now on part of the energy; replaces what was said before.
  void set_evidence(const IdentityEvidence& evidence) { evidence_ = evidence; }

  int frame_count() const { return static_cast<int>(frames_.size()); }
  const FrameState& frame(int index) const { return frames_[static_cast<std::size_t>(index)].state; }
  const SubjectShape& shape() const { return shape_; }

  /// At most `max_iterations` Levenberg-Marquardt steps over the whole batch, from where the last call ended.
  CoarseFitReport improve(int max_iterations);

  /// The part of the landmark residuals that stays with the head from frame to frame: the net's habit on this
  /// face and what the model's identities can't express, [count][3] head frame, mm, measured minus model. It
  /// is shrunk towards 0 by bias_frames, and added to the landmark basis of later frames so that no
  /// expression explains it.
  Eigen::VectorXd landmark_bias_mm();

  /// The energy at the current state, and its gradient by the shared unknowns and by every frame's own
  /// (order: frame 0, frame 1, ..., identity, log focal): what a derivative checker compares.
  double energy();
  Eigen::VectorXd gradient();
  /// Moves the current state by such a vector.
  void move(const Eigen::VectorXd& step);

 private:
  struct BatchFrame {
    BatchFrame(std::span<const landmark::FaceLandmarks* const> landmarks, const FrameState& start,
               int own_count, int shared_count);

    std::vector<landmark::FaceLandmarks> faces;  ///< [view]
    std::vector<Observation> observations;       ///< [view]
    FrameState state;
    FrameState trial;
    NormalEquations equations;
    BoundedStepScratch scratch;
    Eigen::MatrixXd eliminated;  ///< [own][shared + 1] A^-1 (coupling | gradient)
    Eigen::VectorXd step;
  };

  int own_count() const { return kExpressionAt + model_->expression_count(); }
  int shared_count() const { return model_->identity_count() + 1; }
  void observe_views(BatchFrame& frame) const;
  double shared_prior_energy(const SubjectShape& shape) const;
  double batch_energy(const SubjectShape& shape, bool at_trial);
  double linearise();
  bool solve_step(double damping);
  void apply_shared(const Eigen::VectorXd& step, SubjectShape& to) const;

  const LandmarkModel* model_;
  const ExpressionPrior* prior_;
  LandmarkTrust trust_;
  IdentityPriorStrength strength_;
  double log_focal_prior_;
  bool focal_is_fixed_;
  std::vector<FitCamera> cameras_;
  SubjectShape shape_;
  SubjectShape trial_shape_;
  LandmarkTerm landmark_term_;
  LandmarkBasis basis_;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> by_identity_mm_;
  std::optional<IdentityEvidence> evidence_;
  std::vector<BatchFrame> frames_;
  Eigen::MatrixXd shared_hessian_;
  Eigen::VectorXd shared_gradient_;
  Eigen::MatrixXd reduced_hessian_;
  Eigen::VectorXd shared_step_;
  Damping damping_{.smallest = 1e-9};
};

}  // namespace facet::track
