#include "refine/recorded_frames.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>

#include "facet/error.hpp"

namespace facet::refine {
namespace {

using testing::Each;
using testing::ElementsAre;

/// Frames that are recorded without a device: what was recorded, and whether a frame waited for it.
class Frames {
 public:
  explicit Frames(std::optional<StepPlan> constant = std::nullopt)
      : frames({1000, 4000}, std::move(constant), false) {}

  /// One frame, and what is recorded behind it. gain: what each step takes from a level's energy.
  StepPlan run(bool learn, bool next_learns, double gain = 0, bool warm = true, bool may_learn = true) {
    waits_ = true;
    const RecordedFrame& frame = frames.next(warm, learn, limit_ms, record_);
    waits_ = false;
    EXPECT_EQ(frame.learn, learn);
    const StepPlan plan = frame.plan;
    frames.record_ahead(next_learns, may_learn, record_);
    EXPECT_EQ(frame.plan, plan) << "the frame in flight stays";
    std::vector<std::vector<double>> energies(2);
    for (std::size_t level = 0; level < 2; ++level) {
      double energy = 100;
      for (int step = 0; step < plan.steps[level] + (plan.last_energy ? 1 : 0); ++step) {
        energies[level].push_back(energy);
        energy *= 1 - gain;
      }
    }
    frames.planner().learn(energies, displacement_ms, displacement_ms + 1);
    return plan;
  }

  RecordedFrames frames;
  float limit_ms = 0;
  float displacement_ms = 1;
  int waited_for = 0;  ///< recorded while the frame waited
  int ahead = 0;
  bool fails = false;

 private:
  bool waits_ = false;
  RecordedFrames::Record record_ = [this](const StepPlan& /*plan*/, bool /*learn*/) {
    if (fails) {
      throw Error(ErrorKind::NoDevice, "no room for another");
    }
    ++(waits_ ? waited_for : ahead);
    return std::unique_ptr<gpu::Batch>();
  };
};

TEST(RecordedFrames, NoFrameWaitsButTheFirst) {
  Frames all;
  EXPECT_THAT(all.run(true, true, 0, false).steps, Each(3));
  EXPECT_EQ(all.waited_for, 1);
  int probes = 0;
  for (int k = 1; k < 60; ++k) {
    const StepPlan plan = all.run(k < 20 || k % 8 == 0, k + 1 < 20 || (k + 1) % 8 == 0);
    probes += plan.last_energy ? 1 : 0;
  }
  EXPECT_EQ(probes, 5);
  EXPECT_THAT(all.run(false, false, 0, false).steps, Each(3)) << "a cold start";
  EXPECT_EQ(all.waited_for, 1);
  EXPECT_EQ(all.ahead, 5) << "calm frames, probes and cold starts, with and without the albedo";
}

TEST(RecordedFrames, WhatAProbeFoundComesAFrameLater) {
  Frames all;
  all.run(false, false, 0, false, false);
  StepPlan plan;
  while (!plan.last_energy) {
    plan = all.run(false, false, 0, true, false);
    EXPECT_EQ(all.frames.recording_ms(), 0);
  }
  // The next probe finds that every level gains by a step more.
  do {
    plan = all.run(false, false, 0.1, true, false);
  } while (!plan.last_energy);
  EXPECT_THAT(all.run(false, false, 0.1, true, false).steps, ElementsAre(1, 1)) << "not recorded yet";
  EXPECT_THAT(all.run(false, false, 0.1, true, false).steps, ElementsAre(2, 2));
  EXPECT_EQ(all.waited_for, 1);
}

TEST(RecordedFrames, AThinnerPlanThatIsNeededIsNotWaitedFor) {
  Frames all;
  all.run(false, false, 0, false, false);
  all.run(false, false, 0, true, false);
  all.limit_ms = 1.5F;
  all.displacement_ms = 100;
  all.run(false, false, 0, true, false);
  const StepPlan thin = all.run(false, false, 0, true, false);
  EXPECT_EQ(thin.steps.back(), 0);
}

TEST(RecordedFrames, ConstantPlansAreRecordedWithAndWithoutTheAlbedo) {
  const StepPlan plan{{2, 2}, 7, false};
  Frames all(plan);
  EXPECT_EQ(all.run(true, true, 0, false), plan);
  EXPECT_EQ(all.run(true, true), plan);
  EXPECT_EQ(all.run(false, false), plan);
  EXPECT_EQ(all.waited_for, 1);
  EXPECT_EQ(all.ahead, 1);
  all.frames.clear();
  EXPECT_EQ(all.run(false, false), plan);
  EXPECT_EQ(all.waited_for, 2) << "forgotten";
}

TEST(RecordedFrames, WhatCannotBeRecordedAheadIsTriedAgain) {
  Frames all;
  all.run(false, false, 0, false, false);
  const int before = all.ahead;
  all.fails = true;
  all.run(false, false, 0, true, false);
  EXPECT_EQ(all.ahead, before);
  all.fails = false;
  all.run(false, false, 0, true, false);
  EXPECT_EQ(all.ahead, before + 1);
}

}  // namespace
}  // namespace facet::refine
