#include "track/damped_steps.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace facet::track {
namespace {

/// (x^2 - 4)^2 from a place where the undamped step overshoots.
class Valley {
 public:
  explicit Valley(double from) : x(from) {}

  CoarseFitReport solve(int most_iterations, Damping& damping) {
    return damped_steps(
        most_iterations, damping, [&] { return energy(x); },
        [&](double value) {
          ++attempts;
          if (refuses) {
            return std::nan("");
          }
          const double slope = 4 * x * (x * x - 4);
          trial = x - slope / (8 * x * x * (1 + value));
          return energy(trial);
        },
        [&] { x = trial; });
  }
  static double energy(double at) { return (at * at - 4) * (at * at - 4); }

  double x;
  double trial = 0;
  int attempts = 0;
  bool refuses = false;
};

TEST(DampedSteps, FindsTheMinimumAndTellsTheWay) {
  Valley valley(0.1);
  Damping damping;
  const CoarseFitReport report = valley.solve(100, damping);
  EXPECT_EQ(report.outcome, CoarseFitOutcome::Converged);
  EXPECT_NEAR(std::abs(valley.x), 2.0, 1e-3);
  EXPECT_DOUBLE_EQ(report.initial_energy, Valley::energy(0.1));
  EXPECT_DOUBLE_EQ(report.final_energy, Valley::energy(valley.x));
  EXPECT_GT(valley.attempts, report.iterations) << "the first step overshoots and is damped";
}

TEST(DampedSteps, StopsWhereTheIterationsRunOut) {
  Valley valley(0.1);
  Damping damping;
  const CoarseFitReport report = valley.solve(1, damping);
  EXPECT_EQ(report.outcome, CoarseFitOutcome::NotConverged);
  EXPECT_EQ(report.iterations, 1);
  EXPECT_LT(report.final_energy, report.initial_energy);
}

TEST(DampedSteps, WithoutAStepTheStateStaysAndDampingGrows) {
  Valley valley(1.0);
  valley.refuses = true;
  Damping damping;
  const CoarseFitReport report = valley.solve(100, damping);
  EXPECT_EQ(report.outcome, CoarseFitOutcome::Converged);
  EXPECT_EQ(valley.x, 1.0);
  EXPECT_EQ(valley.attempts, 5);
  EXPECT_DOUBLE_EQ(damping.value, 1e5 * Damping::kFirst);
  valley.solve(100, damping);
  EXPECT_EQ(valley.attempts, 10);
  valley.solve(100, damping);
  EXPECT_EQ(valley.attempts, 10) << "more damped than the most there is";
}

TEST(DampedSteps, DampingShrinksNoFurtherThanTheSmallest) {
  Damping damping{.value = 1e-8, .smallest = 1e-9};
  for (int i = 0; i < 4; ++i) {
    Valley valley(1.9);
    valley.solve(1, damping);
  }
  EXPECT_DOUBLE_EQ(damping.value, 1e-9);
}

TEST(DampedSteps, AnEnergyThatIsNoneIsAFailure) {
  Valley valley(std::numeric_limits<double>::infinity());
  Damping damping;
  EXPECT_EQ(valley.solve(10, damping).outcome, CoarseFitOutcome::NumericalFailure);
  EXPECT_EQ(valley.attempts, 0);
}

}  // namespace
}  // namespace facet::track
