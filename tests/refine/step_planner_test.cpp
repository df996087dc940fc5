#include "refine/step_planner.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace facet::refine {
namespace {

using testing::Each;
using testing::ElementsAre;
using testing::HasSubstr;

/// A device on which a solve takes 1 ms per thousand vertices and step of 7 iterations, and all else 5 ms.
class Device {
 public:
  explicit Device(double speed = 1) : speed_(speed) {}

  /// Frame times of a plan, and what each step brings: `gains` of the level's energy, [level][step].
  void run(StepPlanner& planner, const StepPlan& plan, const std::vector<std::uint32_t>& vertices,
           const std::vector<std::vector<double>>& gains = {}) const {
    double ms = 0;
    std::vector<std::vector<double>> energies(plan.steps.size());
    for (std::size_t l = 0; l < plan.steps.size(); ++l) {
      const int steps = plan.steps[l];
      ms += speed_ * vertices[l] * 1e-3 * steps * (3.7 + plan.pcg_iterations) / 10.7;
      double energy = 100;
      for (int step = 0; step < steps + (plan.last_energy ? 1 : 0); ++step) {
        energies[l].push_back(energy);
        const auto at = static_cast<std::size_t>(step);
        energy *= 1 - (l < gains.size() && at < gains[l].size() ? gains[l][at] : 0.0);
      }
    }
    planner.learn(energies, static_cast<float>(ms), static_cast<float>(ms + 5));
    last_ms_ = ms + 5;
  }
  double last_ms() const { return last_ms_; }

 private:
  double speed_;
  mutable double last_ms_ = 0;
};

const std::vector<std::uint32_t> kVertices{8000, 20000, 60000};

TEST(StepPlanner, CalmFramesGetOneStepAndAColdStartMore) {
  StepPlanner planner(kVertices);
  const Device device;
  const StepPlan cold = planner.next(false, 0);
  EXPECT_THAT(cold.steps, Each(3));
  device.run(planner, cold, kVertices);
  int probes = 0;
  for (int k = 0; k < 60; ++k) {
    const StepPlan plan = planner.next(true, 0);
    EXPECT_EQ(plan.pcg_iterations, StepPlanner::kPcgIterations);
    EXPECT_THAT(plan.steps, Each(plan.last_energy ? 2 : 1));
    probes += plan.last_energy ? 1 : 0;
    device.run(planner, plan, kVertices);
  }
  EXPECT_EQ(probes, 5);
  EXPECT_EQ(planner.given_up(), "");
}

TEST(StepPlanner, AStepThatPaysIsMadeAndOneThatNoLongerDoesIsDropped) {
  StepPlanner planner(kVertices);
  const Device device;
  const auto run = [&](int frames, const std::vector<std::vector<double>>& gains) {
    StepPlan plain;
    for (int k = 0; k < frames; ++k) {
      const StepPlan plan = planner.next(true, 0);
      device.run(planner, plan, kVertices, gains);
      plain = plan.last_energy ? plain : plan;
    }
    return plain.steps;
  };
  // A second step on level 1 lowers its energy by 2 %, a third by nothing.
  EXPECT_THAT(run(60, {{0.3, 0.001}, {0.3, 0.02, 0.0001}, {0.3}}), ElementsAre(1, 2, 1));
  EXPECT_THAT(run(60, {{0.3}, {0.3, 0.001}, {0.3}}), Each(1));
  // However much more steps would bring, there is a bound.
  const std::vector<double> always(10, 0.1);
  EXPECT_THAT(run(200, {always, always, always}), Each(StepPlanner::kMostSteps - 1));
}

TEST(StepPlanner, TheTimeLimitTakesIterationsThenTheFinestLevels) {
  const Device device;
  for (const auto& [limit_ms, steps] : std::vector<std::pair<float, std::vector<int>>>{
           {120, {1, 1, 1}}, {70, {1, 1, 1}}, {35, {1, 1, 0}}, {14, {1, 0, 0}}, {1, {1, 0, 0}}}) {
    StepPlanner planner(kVertices);
    for (int k = 0; k < 40; ++k) {
      device.run(planner, planner.next(k > 0, limit_ms), kVertices);
    }
    const StepPlan plan = planner.next(true, limit_ms);
    EXPECT_EQ(plan.steps, steps) << limit_ms;
    device.run(planner, plan, kVertices);
    if (limit_ms >= 14) {
      EXPECT_LE(device.last_ms(), limit_ms);
    }
    EXPECT_EQ(planner.given_up().empty(), limit_ms == 120) << planner.given_up();
  }
}

TEST(StepPlanner, ASlowDeviceIsNoticedWithinAFewFramesAndAFastOneAfterPatience) {
  StepPlanner planner(kVertices);
  constexpr float kLimit_ms = 120;
  for (int k = 0; k < 20; ++k) {
    Device().run(planner, planner.next(k > 0, kLimit_ms), kVertices);
  }
  ASSERT_EQ(planner.rung(), 0);
  // Something else takes the processor: four times slower.
  int frames = 0;
  const Device slow(4);
  while (frames < 50) {
    slow.run(planner, planner.next(true, kLimit_ms), kVertices);
    ++frames;
    if (slow.last_ms() <= static_cast<double>(kLimit_ms)) {
      break;
    }
  }
  EXPECT_LE(frames, 10);
  EXPECT_THAT(planner.given_up(), HasSubstr("120 ms"));
  EXPECT_THAT(planner.given_up(), HasSubstr("level 2"));
  frames = 0;
  while (planner.rung() > 0 && frames < 500) {
    Device().run(planner, planner.next(true, kLimit_ms), kVertices);
    ++frames;
  }
  EXPECT_EQ(planner.rung(), 0);
  EXPECT_GE(frames, StepPlanner::kPatience);
  EXPECT_EQ(planner.given_up(), "");
}

TEST(StepPlanner, ALimitThatGoesTakesNothing) {
  StepPlanner planner(kVertices);
  const Device device;
  for (int k = 0; k < 10; ++k) {
    device.run(planner, planner.next(k > 0, 1), kVertices);
  }
  EXPECT_GT(planner.rung(), 0);
  EXPECT_THAT(planner.next(true, 0).steps, Each(testing::Ge(1)));
  EXPECT_EQ(planner.given_up(), "");
}

}  // namespace
}  // namespace facet::refine
