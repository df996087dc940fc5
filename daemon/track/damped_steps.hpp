#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

namespace facet::track {

/// How a solver ended.
enum class CoarseFitOutcome {
  Converged,
  NotConverged,      ///< the iterations ran out; the state is the best one found
  NumericalFailure,  ///< no usable step or a point behind the camera; the state is as it came in
};

struct CoarseFitReport {
  CoarseFitOutcome outcome = CoarseFitOutcome::NumericalFailure;
  int iterations = 0;
  double initial_energy = std::numeric_limits<double>::infinity();
  double final_energy = std::numeric_limits<double>::infinity();
};

/// The damping of Levenberg-Marquardt's steps, which goes on from one solve to the next where that is wanted.
struct Damping {
  static constexpr double kFirst = 1e-3;
  static constexpr double kLargest = 1e6;

  double value = kFirst;
  double smallest = 0;
};

/// Levenberg-Marquardt: steps downhill until one gains less than 1e-4 of the energy. Where no step is
/// downhill, the state is a minimum as far as double precision shows.
///
/// linearise()       builds the normal equations at the state; returns its energy
/// attempt(damping)  solves them, damped, and steps to a trial state; returns its energy, NaN where there is
///                   no step. Up to five times an iteration, each ten times more damped than the one before
/// accept()          the trial state becomes the state
template <typename Linearise, typename Attempt, typename Accept>
CoarseFitReport damped_steps(int max_iterations, Damping& damping, Linearise&& linearise, Attempt&& attempt,
                             Accept&& accept) {
  constexpr double kConverged = 1e-4;
  constexpr int kAttempts = 5;
  CoarseFitReport report;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    const double before = linearise();
    if (!std::isfinite(before)) {
      return report;
    }
    if (iteration == 0) {
      report.initial_energy = before;
      report.final_energy = before;
      report.outcome = CoarseFitOutcome::NotConverged;
    }
    bool improved = false;
    for (int k = 0; k < kAttempts && !improved && damping.value <= Damping::kLargest; ++k) {
      const double after = attempt(damping.value);
      if (after < before) {
        accept();
        report.final_energy = after;
        improved = true;
        damping.value = std::max(0.1 * damping.value, damping.smallest);
      } else {
        damping.value *= 10.0;
      }
    }
    report.iterations = iteration + 1;
    if (!improved || before - report.final_energy <= kConverged * before) {
      report.outcome = CoarseFitOutcome::Converged;
      break;
    }
  }
  return report;
}

}  // namespace facet::track
