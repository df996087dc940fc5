#include "track/identity_fit.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

namespace facet::track {
namespace {

/// No identity coefficient leaves this many standard deviations, whatever the landmarks say.
constexpr double kLargestIdentity = 4.0;
/// No focal length leaves this range around the prior's median (a factor).
constexpr double kLargestFocalFactor = 4.0;

}  // namespace

IdentityFit::IdentityFit(const LandmarkModel& model, const ExpressionPrior& prior, const LandmarkTrust& trust,
                         const IdentityPriorStrength& strength, double longer_side_px, double fixed_focal_px,
                         std::vector<FitCamera> cameras)
    : model_(&model),
      prior_(&prior),
      trust_(trust),
      strength_(strength),
      log_focal_prior_(std::log(fixed_focal_px > 0 ? fixed_focal_px : strength.focal_ratio * longer_side_px)),
      focal_is_fixed_(fixed_focal_px > 0),
      cameras_(std::move(cameras)),
      landmark_term_(model, trust),
      shared_hessian_(shared_count(), shared_count()),
      shared_gradient_(shared_count()),
      reduced_hessian_(shared_count(), shared_count()),
      shared_step_(shared_count()) {
  shape_.identity = Eigen::VectorXd::Zero(model.identity_count());
  shape_.focal_px = std::exp(log_focal_prior_);
  trial_shape_ = shape_;
}

IdentityFit::BatchFrame::BatchFrame(std::span<const landmark::FaceLandmarks* const> landmarks,
                                    const FrameState& start, int own_count, int shared_count)
    : faces(landmarks.size()),
      observations(landmarks.size()),
      state(start),
      trial(start),
      equations(own_count + shared_count),
      scratch(own_count),
      eliminated(own_count, shared_count + 1),
      step(Eigen::VectorXd::Zero(own_count)) {
  for (std::size_t v = 0; v < landmarks.size(); ++v) {
    observations[v].seen = landmarks[v] != nullptr;
    if (landmarks[v] != nullptr) {
      faces[v] = *landmarks[v];
    }
  }
}

void IdentityFit::add_frame(std::span<const landmark::FaceLandmarks* const> faces, const FrameState& start) {
  observe_views(frames_.emplace_back(faces, start, own_count(), shared_count()));
}

void IdentityFit::observe_views(BatchFrame& frame) const {
  for (std::size_t v = 0; v < frame.faces.size(); ++v) {
    if (frame.observations[v].seen) {
      observe(*model_, trust_, frame.faces[v], frame.state.pose.translation_mm, shape_.focal_px, cameras_[v],
              frame.observations[v]);
    }
  }
  weigh_views(frame.observations);
}

double IdentityFit::shared_prior_energy(const SubjectShape& shape) const {
  const double focal = (std::log(shape.focal_px) - log_focal_prior_) / strength_.log_focal_sigma;
  const double prior =
      frame_count() * 0.5 * (strength_.identity * shape.identity.squaredNorm() + focal * focal);
  if (!evidence_) {
    return prior;
  }
  const Eigen::VectorXd from = shape.identity - evidence_->at;
  return prior + 0.5 * from.dot(evidence_->information * from) - evidence_->pull.dot(from);
}

double IdentityFit::batch_energy(const SubjectShape& shape, bool at_trial) {
  model_->contract_identity(shape.identity, basis_);
  double sum = shared_prior_energy(shape);
  for (const BatchFrame& frame : frames_) {
    const FrameState& state = at_trial ? frame.trial : frame.state;
    double own = 0;
    for (const Observation& view : frame.observations) {
      own += landmark_term_.energy(basis_, view, shape.focal_px, state);
    }
    sum += own + prior_->energy(state.expression);
  }
  return sum;
}

double IdentityFit::linearise() {
  model_->contract_identity(shape_.identity, basis_);
  const int own = own_count();
  const int shared = shared_count();
  double sum = shared_prior_energy(shape_);
  shared_hessian_.setZero();
  shared_gradient_.setZero();
  for (BatchFrame& frame : frames_) {
    model_->contract_expression(frame.state.expression, by_identity_mm_);
    frame.equations.clear();
    for (const Observation& view : frame.observations) {
      sum += landmark_term_.linearise(basis_, view, shape_.focal_px, frame.state, &by_identity_mm_,
                                      frame.equations);
    }
    frame.equations.finish();
    shared_hessian_ += frame.equations.hessian.bottomRightCorner(shared, shared);
    shared_gradient_ += frame.equations.gradient.tail(shared);
    prior_->add(frame.state.expression, kExpressionAt, frame.equations.hessian, frame.equations.gradient);
    sum += prior_->energy(frame.state.expression);
    std::fill(frame.scratch.held.begin(), frame.scratch.held.end(), '\0');
    hold_bounded(frame.state.expression, frame.equations.gradient.head(own), kExpressionAt,
                 frame.scratch.held);
  }
  const int identities = model_->identity_count();
  const double frames = frame_count();
  shared_hessian_.diagonal().head(identities).array() += frames * strength_.identity;
  shared_gradient_.head(identities) += frames * strength_.identity * shape_.identity;
  if (evidence_) {
    shared_hessian_.topLeftCorner(identities, identities) += evidence_->information;
    shared_gradient_.head(identities) +=
        evidence_->information * (shape_.identity - evidence_->at) - evidence_->pull;
  }
  const double information = frames / (strength_.log_focal_sigma * strength_.log_focal_sigma);
  shared_hessian_(identities, identities) += information;
  shared_gradient_[identities] += information * (std::log(shape_.focal_px) - log_focal_prior_);
  return sum;
}

bool IdentityFit::solve_step(double damping) {
  // (A_f  B_f; B_f^T  C) (x_f; y) = -(a_f; c):
  //   (C - sum B_f^T A_f^-1 B_f) y = -c + sum B_f^T A_f^-1 a_f,  x_f = -A_f^-1 (a_f + B_f y)
  const int own = own_count();
  const int shared = shared_count();
  reduced_hessian_ = shared_hessian_;
  reduced_hessian_.diagonal() += damping * shared_hessian_.diagonal();
  shared_step_ = -shared_gradient_;
  for (BatchFrame& frame : frames_) {
    Eigen::MatrixXd& damped = frame.scratch.damped;
    damped = frame.equations.hessian.topLeftCorner(own, own);
    frame.eliminated.leftCols(shared) = frame.equations.hessian.topRightCorner(own, shared);
    frame.eliminated.col(shared) = frame.equations.gradient.head(own);
    for (int i = 0; i < own; ++i) {
      damped(i, i) *= 1.0 + damping;
      if (frame.scratch.held[static_cast<std::size_t>(i)] != 0) {
        damped.row(i).setZero();
        damped.col(i).setZero();
        damped(i, i) = 1.0;
        frame.eliminated.row(i).setZero();
      }
    }
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> cholesky(damped);
    if (cholesky.info() != Eigen::Success) {
      return false;
    }
    cholesky.solveInPlace(frame.eliminated);
    // Rows of held unknowns are 0 in `eliminated`, so B_f may be read unmasked from the full matrix.
    const auto coupling = frame.equations.hessian.bottomLeftCorner(shared, own);
    reduced_hessian_.noalias() -= coupling * frame.eliminated.leftCols(shared);
    shared_step_.noalias() += coupling * frame.eliminated.col(shared);
  }
  if (focal_is_fixed_) {
    const int focal = shared - 1;
    reduced_hessian_.row(focal).setZero();
    reduced_hessian_.col(focal).setZero();
    reduced_hessian_(focal, focal) = 1.0;
    shared_step_[focal] = 0.0;
  }
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> cholesky(reduced_hessian_);
  if (cholesky.info() != Eigen::Success) {
    return false;
  }
  cholesky.solveInPlace(shared_step_);
  if (!shared_step_.allFinite()) {
    return false;
  }
  for (BatchFrame& frame : frames_) {
    frame.step = -frame.eliminated.col(shared);
    frame.step.noalias() -= frame.eliminated.leftCols(shared) * shared_step_;
    if (!frame.step.allFinite()) {
      return false;
    }
  }
  return true;
}

void IdentityFit::apply_shared(const Eigen::VectorXd& step, SubjectShape& to) const {
  const int identities = model_->identity_count();
  to.identity =
      (shape_.identity + step.head(identities)).cwiseMax(-kLargestIdentity).cwiseMin(kLargestIdentity);
  const double limit = std::log(kLargestFocalFactor);
  to.focal_px = std::exp(std::clamp(std::log(shape_.focal_px) + step[identities], log_focal_prior_ - limit,
                                    log_focal_prior_ + limit));
}

CoarseFitReport IdentityFit::improve(int max_iterations) {
  if (frames_.empty()) {
    return {};
  }
  for (BatchFrame& frame : frames_) {
    observe_views(frame);
  }
  damping_.value = std::min(damping_.value, Damping::kFirst);
  return damped_steps(
      max_iterations, damping_, [&] { return linearise(); },
      [&](double value) {
        if (!solve_step(value)) {
          return std::nan("");
        }
        apply_shared(shared_step_, trial_shape_);
        for (BatchFrame& frame : frames_) {
          apply_step(frame.state, frame.step, frame.trial);
        }
        return batch_energy(trial_shape_, true);
      },
      [&] {
        std::swap(shape_, trial_shape_);
        for (BatchFrame& frame : frames_) {
          std::swap(frame.state, frame.trial);
        }
      });
}

Eigen::VectorXd IdentityFit::landmark_bias_mm() {
  model_->contract_identity(shape_.identity, basis_);
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(Eigen::Index{3} * model_->count());
  Eigen::VectorXd seen = Eigen::VectorXd::Constant(model_->count(), strength_.bias_frames);
  Eigen::Matrix2Xd residuals_px;
  for (const BatchFrame& frame : frames_) {
    for (std::size_t v = 0; v < frame.observations.size(); ++v) {
      const Observation& view = frame.observations[v];
      if (!view.seen ||
          !landmark_term_.residuals_px(basis_, view, shape_.focal_px, frame.state, true, residuals_px)) {
        continue;
      }
      const FitCamera& camera = view.camera;
      const Eigen::Matrix3d rotation = camera.view_from_reference.linear() * frame.state.pose.rotation;
      const double mm_per_px = (camera.view_from_reference * frame.state.pose.translation_mm).z() /
                               (camera.focal_ratio * shape_.focal_px);
      for (Eigen::Index l = 0; l < model_->count(); ++l) {
        const double weight =
            landmark::confidence_of(frame.faces[v], model_->landmarks()[static_cast<std::size_t>(l)]);
        const Eigen::Vector3d measured_minus_model(-mm_per_px * residuals_px(0, l),
                                                   -mm_per_px * residuals_px(1, l), 0.0);
        sum.segment<3>(3 * l) += weight * rotation.transpose() * measured_minus_model;
        seen[l] += weight;
      }
    }
  }
  for (Eigen::Index l = 0; l < model_->count(); ++l) {
    sum.segment<3>(3 * l) /= seen[l];
  }
  return sum;
}

double IdentityFit::energy() {
  return batch_energy(shape_, false);
}

Eigen::VectorXd IdentityFit::gradient() {
  linearise();
  const Eigen::Index own = own_count();
  Eigen::VectorXd all(frame_count() * own + shared_count());
  for (int f = 0; f < frame_count(); ++f) {
    all.segment(f * own, own) = frames_[static_cast<std::size_t>(f)].equations.gradient.head(own);
  }
  all.tail(shared_count()) = shared_gradient_;
  return all;
}

void IdentityFit::move(const Eigen::VectorXd& step) {
  const Eigen::Index own = own_count();
  for (int f = 0; f < frame_count(); ++f) {
    BatchFrame& frame = frames_[static_cast<std::size_t>(f)];
    apply_step(frame.state, step.segment(f * own, own), frame.trial);
    std::swap(frame.state, frame.trial);
  }
  apply_shared(step.tail(shared_count()), trial_shape_);
  std::swap(shape_, trial_shape_);
}

}  // namespace facet::track
