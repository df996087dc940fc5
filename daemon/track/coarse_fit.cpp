#include "track/coarse_fit.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace facet::track {
namespace {

double huber(double scaled, double threshold) {
  const double size = std::abs(scaled);
  return size <= threshold ? 0.5 * size * size : threshold * (size - 0.5 * threshold);
}

double huber_weight(double scaled, double threshold) {
  const double size = std::abs(scaled);
  return size <= threshold ? 1.0 : threshold / size;
}

/// Rotation from the previous frame to this one, as a vector in camera axes.
Eigen::Vector3d turned(const FrameState& previous, const FrameState& state) {
  return vector_from_rotation(state.pose.rotation * previous.pose.rotation.transpose());
}

}  // namespace

void hold_bounded(const Eigen::VectorXd& expression, const Eigen::VectorXd& gradient, int at,
                  std::vector<char>& held) {
  for (Eigen::Index k = 0; k < expression.size(); ++k) {
    const double g = gradient[at + k];
    held[static_cast<std::size_t>(at + k)] =
        static_cast<char>((expression[k] <= 0.0 && g > 0.0) || (expression[k] >= 1.0 && g < 0.0));
  }
}

CoarseFit::CoarseFit(const LandmarkModel& model, const ExpressionPrior& prior, const LandmarkTrust& trust,
                     const TemporalPriorStrength& temporal)
    : prior_(&prior),
      temporal_(temporal),
      landmark_term_(model, trust),
      equations_(kExpressionAt + model.expression_count()),
      scratch_(kExpressionAt + model.expression_count()),
      step_(kExpressionAt + model.expression_count()) {
  trial_.expression.setZero(model.expression_count());
}

CoarseFit::TemporalScale CoarseFit::temporal_scale(double elapsed_s) const {
  // A longer gap says nothing more about where the face is.
  constexpr double kLongestGapS = 1.0;
  constexpr double kShortestGapS = 1e-3;
  const double growth = std::sqrt(std::clamp(elapsed_s, kShortestGapS, kLongestGapS));
  return {1.0 / (temporal_.rotation_rad * growth), 1.0 / (temporal_.lateral_mm * growth),
          1.0 / (temporal_.depth_mm * growth), 1.0 / (temporal_.expression * growth)};
}

double CoarseFit::temporal_energy(const TemporalPrior& previous, const FrameState& state) const {
  const TemporalScale scale = temporal_scale(previous.elapsed_s);
  const Eigen::Vector3d rotation = turned(previous.previous, state) * scale.rotation;
  const Eigen::Vector3d moved = state.pose.translation_mm - previous.previous.pose.translation_mm;
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    sum += huber(rotation[i], temporal_.huber_sigmas);
    sum += huber(moved[i] * (i == 2 ? scale.depth : scale.lateral), temporal_.huber_sigmas);
  }
  for (Eigen::Index k = 0; k < state.expression.size(); ++k) {
    sum += huber((state.expression[k] - previous.previous.expression[k]) * scale.expression,
                 temporal_.huber_sigmas);
  }
  return temporal_.strength * sum;
}

void CoarseFit::add_temporal(const TemporalPrior& previous, const FrameState& state,
                             NormalEquations& equations) const {
  const TemporalScale scale = temporal_scale(previous.elapsed_s);
  const Eigen::Vector3d rotation = turned(previous.previous, state);
  const Eigen::Matrix3d by_increment = left_jacobian_inverse(rotation);
  const Eigen::Vector3d moved = state.pose.translation_mm - previous.previous.pose.translation_mm;
  for (int i = 0; i < 3; ++i) {
    const double turn = rotation[i] * scale.rotation;
    const double turn_weight = temporal_.strength * huber_weight(turn, temporal_.huber_sigmas);
    const Eigen::RowVector3d row = by_increment.row(i) * scale.rotation;
    equations.hessian.block<3, 3>(kRotationAt, kRotationAt) += turn_weight * row.transpose() * row;
    equations.gradient.segment<3>(kRotationAt) += turn_weight * turn * row.transpose();

    const double per_mm = i == 2 ? scale.depth : scale.lateral;
    const double move_weight = temporal_.strength * huber_weight(moved[i] * per_mm, temporal_.huber_sigmas);
    equations.hessian(kTranslationAt + i, kTranslationAt + i) += move_weight * per_mm * per_mm;
    equations.gradient[kTranslationAt + i] += move_weight * per_mm * per_mm * moved[i];
  }
  for (Eigen::Index k = 0; k < state.expression.size(); ++k) {
    const double change = (state.expression[k] - previous.previous.expression[k]) * scale.expression;
    const double weight = temporal_.strength * huber_weight(change, temporal_.huber_sigmas);
    equations.hessian(kExpressionAt + k, kExpressionAt + k) += weight * scale.expression * scale.expression;
    equations.gradient[kExpressionAt + k] += weight * scale.expression * change;
  }
}

double CoarseFit::energy(const LandmarkBasis& basis, std::span<const Observation> views, double focal_px,
                         const TemporalPrior* previous, const FrameState& state) {
  double sum = 0;
  for (const Observation& view : views) {
    sum += landmark_term_.energy(basis, view, focal_px, state);
  }
  sum += prior_->energy(state.expression);
  if (previous != nullptr) {
    sum += temporal_energy(*previous, state);
  }
  return sum;
}

double CoarseFit::linearise(const LandmarkBasis& basis, std::span<const Observation> views, double focal_px,
                            const TemporalPrior* previous, const FrameState& state,
                            NormalEquations& equations) {
  equations.clear();
  double sum = 0;
  for (const Observation& view : views) {
    sum += landmark_term_.linearise(basis, view, focal_px, state, nullptr, equations);
  }
  equations.finish();
  prior_->add(state.expression, kExpressionAt, equations.hessian, equations.gradient);
  sum += prior_->energy(state.expression);
  if (previous != nullptr) {
    add_temporal(*previous, state, equations);
    sum += temporal_energy(*previous, state);
  }
  return sum;
}

CoarseFitReport CoarseFit::solve(const LandmarkBasis& basis, std::span<const Observation> views,
                                 double focal_px, const TemporalPrior* previous, int max_iterations,
                                 FrameState& state) {
  Damping damping;
  return damped_steps(
      max_iterations, damping,
      [&] {
        const double at_state = linearise(basis, views, focal_px, previous, state, equations_);
        hold_bounded(state.expression, equations_.gradient, kExpressionAt, scratch_.held);
        return at_state;
      },
      [&](double value) {
        if (!solve_bounded_step(equations_.hessian, equations_.gradient, value, scratch_, step_)) {
          return std::nan("");
        }
        apply_step(state, step_, trial_);
        return energy(basis, views, focal_px, previous, trial_);
      },
      [&] { std::swap(state, trial_); });
}

}  // namespace facet::track
