#pragma once

#include <Eigen/Core>
#include <span>

#include "track/damped_steps.hpp"
#include "track/expression_prior.hpp"
#include "track/landmark_model.hpp"
#include "track/landmark_term.hpp"
#include "track/normal_equations.hpp"

namespace facet::track {

/// How much a face moves between frames, as standard deviations after one second of a random walk; over dt
/// seconds they shrink with sqrt(dt). From huber_sigmas on, a change costs linearly: jitter is held, movement
/// passes.
struct TemporalPriorStrength {
  double rotation_rad = 0.06;
  double lateral_mm = 6.0;
  double depth_mm = 20.0;
  double expression = 0.35;
  double huber_sigmas = 1.0;
  double strength = 1.0;  ///< factor of the whole term
};

/// The frame before, for the temporal prior.
struct TemporalPrior {
  FrameState previous;
  double elapsed_s = 0;  ///< > 0
};

/// Solves pose and expression of one frame for a held identity and focal length:
///   E = sum over the views of E_data (LandmarkTerm) + E_expression (ExpressionPrior) + E_temporal
/// by Levenberg-Marquardt with analytic derivatives; expressions stay in [0, 1] by an active set. No
/// allocation after construction. One thread.
class CoarseFit {
 public:
  CoarseFit(const LandmarkModel& model, const ExpressionPrior& prior, const LandmarkTrust& trust,
            const TemporalPriorStrength& temporal);

  /// Improves `state`, of the reference camera. views: what each camera measured in this frame. focal_px: of
  /// the reference camera. previous may be null: no temporal prior then.
  CoarseFitReport solve(const LandmarkBasis& basis, std::span<const Observation> views, double focal_px,
                        const TemporalPrior* previous, int max_iterations, FrameState& state);

  /// The whole energy at a state; infinite where a landmark lies behind the camera.
  double energy(const LandmarkBasis& basis, std::span<const Observation> views, double focal_px,
                const TemporalPrior* previous, const FrameState& state);

  /// Gauss-Newton matrix and gradient of `energy` at a state, unknowns in the order of kRotationAt ...;
  /// returns the energy.
  double linearise(const LandmarkBasis& basis, std::span<const Observation> views, double focal_px,
                   const TemporalPrior* previous, const FrameState& state, NormalEquations& equations);

  LandmarkTerm& landmark_term() { return landmark_term_; }

 private:
  struct TemporalScale {
    double rotation, lateral, depth, expression;  ///< 1 / sigma
  };
  TemporalScale temporal_scale(double elapsed_s) const;
  double temporal_energy(const TemporalPrior& previous, const FrameState& state) const;
  void add_temporal(const TemporalPrior& previous, const FrameState& state, NormalEquations& equations) const;

  const ExpressionPrior* prior_;
  TemporalPriorStrength temporal_;
  LandmarkTerm landmark_term_;
  NormalEquations equations_;
  BoundedStepScratch scratch_;
  Eigen::VectorXd step_;
  FrameState trial_;
};

/// Marks expressions that rest on a bound and would leave it: held[at + k] = 1 where expression k is 0 and
/// its gradient positive, or 1 and its gradient negative.
void hold_bounded(const Eigen::VectorXd& expression, const Eigen::VectorXd& gradient, int at,
                  std::vector<char>& held);

}  // namespace facet::track
