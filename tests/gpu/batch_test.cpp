#include "gpu/batch.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <limits>
#include <random>
#include <thread>
#include <vector>

#include "gpu/hazards.hpp"
#include "shaders/layout.h"
#include "support/gpu.hpp"
#include "test_gpu_shaders.hpp"

namespace facet::gpu {
namespace {

using shaders::vec4;
using shaders::test_gpu::CountPush;
using shaders::test_gpu::ScalePush;

class BatchTest : public test::GpuTest {
 protected:
  Kernel accumulate() { return {context(), shaders::test_gpu::kernels(), "accumulate"}; }
};

/// What `steps` alternating accumulate steps between two buffers give.
std::array<std::vector<std::int32_t>, 2> reference(std::array<std::vector<std::int32_t>, 2> values,
                                                   int steps) {
  const std::size_t count = values[0].size();
  for (int step = 0; step < steps; ++step) {
    const std::vector<std::int32_t>& previous = values[static_cast<std::size_t>(step % 2)];
    std::vector<std::int32_t>& next = values[static_cast<std::size_t>((step + 1) % 2)];
    for (std::size_t index = 0; index < count; ++index) {
      next[index] += previous[(index * 7919 + 1) % count] + 1;
    }
  }
  return values;
}

TEST_F(BatchTest, WhatIsWrittenHasOneName) {
  const Buffer both(context(), 64 * 4, Memory::Device, "both");
  const Kernel kernel = accumulate();
  Batch batch(context(), "aliased");
  const auto dispatch = [&](const Buffer& previous) {
    batch.dispatch(kernel, {{"previous", previous}, {"values", both}}, {1}, CountPush{64});
  };
  try {
    dispatch(both);
    FAIL() << "one buffer is read and written by two names";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Internal);
    EXPECT_THAT(error.what(), testing::AllOf(testing::HasSubstr("'previous' and 'values'"),
                                             testing::HasSubstr("accumulate")));
  }
  EXPECT_NO_THROW(dispatch(Buffer(context(), 64 * 4, Memory::Device, "another")));
}

// Every step needs what all workgroups of the step before wrote; many of them, so that a missing barrier
// shows.
TEST_F(BatchTest, StepsSeeTheStepsBeforeAndABatchCanRunAgain) {
  constexpr std::uint32_t count = 10'007;
  constexpr int steps = 20;
  const std::array<Buffer, 2> buffers{Buffer(context(), count * 4, Memory::Device, "even"),
                                      Buffer(context(), count * 4, Memory::Device, "odd")};
  const Kernel kernel = accumulate();
  Batch batch(context(), "ping pong");
  for (std::size_t step = 0; step < steps; ++step) {
    batch.dispatch(kernel, {{"previous", buffers[step % 2]}, {"values", buffers[(step + 1) % 2]}},
                   {groups_for(count, 64)}, CountPush{count});
  }
  batch.finish();
  EXPECT_EQ(batch.counts().dispatches, static_cast<std::size_t>(steps));
  EXPECT_EQ(batch.counts().barriers, static_cast<std::size_t>(steps - 1));

  std::array<std::vector<std::int32_t>, 2> expected{std::vector<std::int32_t>(count),
                                                    std::vector<std::int32_t>(count)};
  std::mt19937 random(13);
  for (int run = 0; run < 5; ++run) {
    for (std::size_t side = 0; side < 2; ++side) {
      for (std::int32_t& value : expected[side]) {
        value = static_cast<std::int32_t>(random() % 10);
      }
      upload<std::int32_t>(context(), buffers[side], expected[side]);
    }
    ASSERT_EQ(batch.submit(), Outcome::Done);
    EXPECT_TRUE(batch.in_flight());
    ASSERT_EQ(batch.wait(), Outcome::Done);
    EXPECT_FALSE(batch.in_flight());
    expected = reference(expected, steps);
    for (std::size_t side = 0; side < 2; ++side) {
      std::vector<std::int32_t> back(count);
      download<std::int32_t>(context(), buffers[side], back);
      EXPECT_EQ(back, expected[side]) << "run " << run;
    }
  }
}

// Two batches submitted without waiting in between run in order, the second sees what the first wrote.
TEST_F(BatchTest, SubmissionsRunInOrder) {
  const Buffer buffer(context(), 1 << 20, Memory::Device, "buffer");
  const Buffer copy(context(), 1 << 20, Memory::Readback, "copy");
  Batch first(context(), "first");
  first.fill(buffer, 11);
  first.finish();
  Batch second(context(), "second");
  second.copy(buffer, copy);
  second.finish();
  Batch third(context(), "third");
  third.fill(buffer, 22);
  third.finish();
  for (int run = 0; run < 10; ++run) {
    ASSERT_EQ(first.submit(), Outcome::Done);
    ASSERT_EQ(second.submit(), Outcome::Done);
    ASSERT_EQ(third.submit(), Outcome::Done);
    ASSERT_EQ(second.wait(), Outcome::Done);
    EXPECT_EQ(copy.mapped_as<std::uint32_t>()[0], 11U);
    EXPECT_EQ(copy.mapped_as<std::uint32_t>().back(), 11U);
    ASSERT_EQ(first.wait(), Outcome::Done);
    ASSERT_EQ(third.wait(), Outcome::Done);
  }
}

TEST_F(BatchTest, BarriersStandOnlyWhereOneStepNeedsAnother) {
  const Buffer a(context(), 256, Memory::Device, "a");
  const Buffer b(context(), 256, Memory::Device, "b");
  const Buffer c(context(), 256, Memory::Device, "c");
  Batch batch(context(), "barriers");
  const auto barriers = [&] { return batch.counts().barriers; };
  batch.fill(a, 1, 0, 128);
  batch.fill(a, 2, 128, 128);  // another range
  batch.fill(b, 3);
  EXPECT_EQ(barriers(), 0U);
  batch.copy(a, c, 128);  // reads what was written
  EXPECT_EQ(barriers(), 1U);
  batch.copy(a, c, 64, 0, 128);  // reads the same, writes elsewhere
  EXPECT_EQ(barriers(), 1U);
  batch.fill(a, 4, 200, 4);  // writes what nobody read since the barrier
  EXPECT_EQ(barriers(), 1U);
  batch.fill(a, 4, 100, 4);  // writes what was read
  EXPECT_EQ(barriers(), 2U);
  batch.fill(a, 5, 100, 4);  // writes what was written
  EXPECT_EQ(barriers(), 3U);
  batch.finish();
  ASSERT_EQ(batch.submit(), Outcome::Done);
  ASSERT_EQ(batch.wait(), Outcome::Done);
  std::vector<std::uint32_t> back(64);
  download<std::uint32_t>(context(), a, back);
  EXPECT_EQ(back[25], 5U);
  EXPECT_EQ(back[50], 4U);
  download<std::uint32_t>(context(), c, back);
  EXPECT_EQ(back[0], 1U);
  EXPECT_EQ(back[40], 1U);
}

TEST(HazardTrackerTest, KnowsEveryKindOfConflict) {
  HazardTracker tracker;
  const auto conflicts = [&](const Access& access) { return tracker.wait_for({&access, 1}).after != 0; };
  const std::array first{Access{1, 0, 100, false}, Access{2, 10, 20, true}};
  EXPECT_EQ(tracker.wait_for(first).after, 0U) << "nothing before it";
  tracker.add(first);
  EXPECT_FALSE(conflicts({1, 0, 100, false})) << "read after read";
  EXPECT_TRUE(conflicts({1, 99, 100, true})) << "write after read";
  EXPECT_FALSE(conflicts({1, 100, 101, true})) << "behind what was read";
  EXPECT_TRUE(conflicts({2, 19, 30, false})) << "read after write";
  EXPECT_TRUE(conflicts({2, 0, 11, true})) << "write after write";
  EXPECT_FALSE(conflicts({2, 0, 10, true})) << "before what was written";
  EXPECT_FALSE(conflicts({3, 0, 100, true})) << "another resource";
  tracker.waited({Wait::bit(By::Kernel), Wait::bit(By::Kernel)});
  EXPECT_FALSE(conflicts({2, 0, 100, true}));
}

// A barrier names those alone who must wait, and those alone for whom: a copy has not waited where kernels
// have.
TEST(HazardTrackerTest, BarriersNameWhoWaitsForWhom) {
  constexpr std::uint32_t kernel = Wait::bit(By::Kernel);
  constexpr std::uint32_t copy = Wait::bit(By::Copy);
  constexpr std::uint32_t indirect = Wait::bit(By::Indirect);
  HazardTracker tracker;
  const auto step = [&](std::initializer_list<Access> accesses) {
    const std::span<const Access> all(accesses.begin(), accesses.size());
    const Wait wait = tracker.wait_for(all);
    tracker.waited(wait);
    tracker.add(all);
    return std::pair(wait.before, wait.after);
  };
  using Sets = std::pair<std::uint32_t, std::uint32_t>;
  EXPECT_EQ(step({{1, 0, 100, true}}), Sets(0, 0));
  EXPECT_EQ(step({{1, 0, 100, false}, {2, 0, 12, true}}), Sets(kernel, kernel));
  EXPECT_EQ(step({{1, 0, 100, false}}), Sets(0, 0)) << "kernels have waited for 1";
  EXPECT_EQ(step({{1, 0, 100, false, By::Copy}, {3, 0, 100, true, By::Copy}}), Sets(kernel, copy));
  EXPECT_EQ(step({{2, 0, 12, false, By::Indirect}, {4, 0, 100, true}}), Sets(kernel | copy, indirect))
      << "the copy, too: its access was not waited for either";
  EXPECT_EQ(step({{2, 0, 12, true}}), Sets(kernel | copy | indirect, kernel)) << "write after indirect read";
  EXPECT_EQ(step({{3, 0, 100, false}, {2, 0, 12, false, By::Indirect}}), Sets(kernel | indirect, indirect))
      << "kernels waited for the copy already";
}

// The device decides how much runs; none at all is a way to skip a step.
TEST_F(BatchTest, IndirectDispatchTakesItsCountFromTheDevice) {
  constexpr std::uint32_t count = 64 * 5;
  const Buffer wanted(context(), 4, Memory::Upload, "wanted");
  const std::size_t at = context().info().buffer_alignment_bytes;
  const Buffer counts(context(), at + 16, Memory::Device, "counts");
  const Buffer zeros(context(), count * 4, Memory::Device, "zeros");
  const Buffer values(context(), count * 4, Memory::Readback, "values");
  const Kernel decide(context(), shaders::test_gpu::kernels(), "counts");
  const Kernel kernel = accumulate();
  Batch batch(context(), "indirect");
  batch.fill(zeros);
  batch.fill(values);
  batch.dispatch(decide, {{"wanted", wanted}, {"counts", counts, at}}, {1});
  batch.dispatch_indirect(kernel, {{"previous", zeros}, {"values", values}}, counts, at, CountPush{count});
  EXPECT_EQ(batch.counts().barriers, 1U);
  EXPECT_THROW(batch.dispatch_indirect(kernel, {{"previous", zeros}, {"values", values}}, counts, at + 8,
                                       CountPush{count}),
               Error);
  EXPECT_THROW(
      batch.dispatch_indirect(kernel, {{"previous", zeros}, {"values", values}}, counts, 2, CountPush{count}),
      Error);
  batch.finish();
  for (const std::uint32_t groups : {5U, 0U, 2U}) {
    wanted.mapped_as<std::uint32_t>()[0] = groups;
    ASSERT_EQ(batch.submit(), Outcome::Done);
    ASSERT_EQ(batch.wait(), Outcome::Done);
    for (std::uint32_t index = 0; index < count; ++index) {
      ASSERT_EQ(values.mapped_as<std::int32_t>()[index], index < 64 * groups ? 1 : 0) << groups << " groups";
    }
  }
}

TEST_F(BatchTest, StagesAreTimedByName) {
  constexpr std::uint32_t count = 1 << 20;
  const Buffer big(context(), count * sizeof(vec4), Memory::Device, "big");
  const TexelView view(big, TexelFormat::Rgba32f);
  const Buffer target(context(), count * sizeof(vec4), Memory::Device, "target");
  const Kernel scale(context(), shaders::test_gpu::kernels(), "scale");
  Batch batch(context(), "timed");
  batch.stage("clear");
  batch.fill(big, 0);
  batch.stage("scale");
  batch.dispatch(scale, {{"source", view}, {"target", target}}, {groups_for(count, 64)},
                 ScalePush{{1.0F, 0.0F, 0.0F, 0.0F}, count, 1.0F});
  batch.stage("nothing");
  batch.stage("scale");
  batch.dispatch(scale, {{"source", view}, {"target", target}}, {groups_for(count, 64)},
                 ScalePush{{1.0F, 0.0F, 0.0F, 0.0F}, count, 1.0F});
  batch.finish();
  EXPECT_EQ(batch.stage_ms("scale"), 0.0F) << "before the first run";
  float least_scale_ms = std::numeric_limits<float>::max();
  float least_nothing_ms = std::numeric_limits<float>::max();
  for (int run = 0; run < 10; ++run) {
    const auto start = std::chrono::steady_clock::now();
    ASSERT_EQ(batch.submit(), Outcome::Done);
    ASSERT_EQ(batch.wait(), Outcome::Done);
    const std::chrono::duration<float, std::milli> elapsed = std::chrono::steady_clock::now() - start;
    const std::span<const StageTime> times = batch.stage_times();
    ASSERT_EQ(times.size(), 4U);
    EXPECT_EQ(times[0].name, "clear");
    EXPECT_EQ(times[1].name, "scale");
    EXPECT_GT(times[1].ms, 0.0F);
    least_scale_ms = std::min(least_scale_ms, times[1].ms);
    least_nothing_ms = std::min(least_nothing_ms, times[2].ms);
    EXPECT_FLOAT_EQ(batch.stage_ms("scale"), times[1].ms + times[3].ms);
    EXPECT_EQ(batch.stage_ms("no such stage"), 0.0F);
    // The stages lie within the wait; the clocks of device and host may differ by a percent.
    EXPECT_LE(times[0].ms + times[1].ms + times[2].ms + times[3].ms, 1.01F * elapsed.count());
  }
  // The least of ten runs: on a busy machine a single one may lose the core anywhere.
  EXPECT_GT(least_scale_ms, least_nothing_ms) << "a million elements take longer than nothing";
}

TEST_F(BatchTest, EveryStepIsTimedWhereAsked) {
  const Buffer zeros(context(), 64, Memory::Device, "zeros");
  const Buffer values(context(), 64, Memory::Readback, "values");
  const Kernel kernel = accumulate();
  Batch batch(context(), "timed", 5);
  batch.time_dispatches();
  batch.stage("solve");
  batch.fill(zeros);
  batch.stage("solve/1");
  batch.dispatch(kernel, {{"previous", zeros}, {"values", values}}, {1}, CountPush{16});
  batch.copy(zeros, values);
  EXPECT_THROW(batch.fill(zeros), Error) << "no room for a sixth time";
  batch.finish();
  ASSERT_EQ(batch.submit(), Outcome::Done);
  ASSERT_EQ(batch.wait(), Outcome::Done);
  std::vector<std::string> names;
  float sum_ms = 0;
  for (const StageTime& stage : batch.stage_times()) {
    names.push_back(stage.name);
    sum_ms += stage.ms;
  }
  EXPECT_THAT(names,
              testing::ElementsAre("solve", "solve/fill", "solve/1", "solve/1/accumulate", "solve/1/copy"));
  EXPECT_FLOAT_EQ(batch.stage_ms("solve"), sum_ms);
  EXPECT_FLOAT_EQ(batch.stage_ms("solve/1/copy"), batch.stage_times()[4].ms);
  EXPECT_EQ(batch.stage_ms("sol"), 0.0F);
  batch.reset();
  batch.fill(zeros);
  batch.finish();
  EXPECT_TRUE(batch.stage_times().empty()) << "a batch that is recorded anew is not timed";
}

TEST_F(BatchTest, MisuseIsRefused) {
  const Buffer buffer(context(), 64, Memory::Device, "buffer");
  Batch batch(context(), "misused");
  EXPECT_THROW(batch.submit(), Error) << "before finish";
  EXPECT_THROW(batch.copy(buffer, buffer, 8, 0, 32), Error) << "onto itself";
  EXPECT_THROW(batch.fill(buffer, 0, 2, 4), Error) << "not a multiple of 4";
  EXPECT_THROW(batch.fill(buffer, 0, 60, 8), Error) << "past the end";
  batch.fill(buffer);
  for (std::size_t stage = 0; stage < Batch::max_stages; ++stage) {
    batch.stage("stage");
  }
  EXPECT_THROW(batch.stage("one more"), Error);
  batch.finish();
  EXPECT_THROW(batch.finish(), Error);
  EXPECT_THROW(batch.fill(buffer), Error) << "after finish";
  ASSERT_EQ(batch.submit(), Outcome::Done);
  EXPECT_THROW(batch.submit(), Error) << "in flight";
  EXPECT_THROW(batch.reset(), Error) << "in flight";
  ASSERT_EQ(batch.wait(), Outcome::Done);
  EXPECT_EQ(batch.wait(), Outcome::Done) << "nothing in flight";
}

TEST_F(BatchTest, ResetRecordsAnew) {
  const Buffer buffer(context(), 64, Memory::Readback, "buffer");
  const Kernel kernel = accumulate();
  const Buffer zeros(context(), 64, Memory::Device, "zeros");
  Batch batch(context(), "again");
  for (std::uint32_t round = 0; round < 200; ++round) {  // more sets than one pool holds, over all rounds
    batch.stage("all");
    batch.fill(buffer, round);
    batch.fill(zeros);
    batch.dispatch(kernel, {{"previous", zeros}, {"values", buffer}}, {1}, CountPush{16});
    batch.finish();
    ASSERT_EQ(batch.submit(), Outcome::Done);
    ASSERT_EQ(batch.wait(), Outcome::Done);
    ASSERT_EQ(buffer.mapped_as<std::uint32_t>()[3], round + 1);
    batch.reset();
    EXPECT_TRUE(batch.stage_times().empty());
    EXPECT_EQ(batch.counts().dispatches, 0U);
  }
}

// More dispatches in one batch than a descriptor pool holds.
TEST_F(BatchTest, ManyDispatchesInOneBatch) {
  constexpr int steps = 500;
  const Buffer zeros(context(), 64, Memory::Device, "zeros");
  const Buffer values(context(), 64, Memory::Readback, "values");
  const Kernel kernel = accumulate();
  run_now(context(), "many", [&](Batch& batch) {
    batch.fill(zeros);
    batch.fill(values);
    for (int step = 0; step < steps; ++step) {
      batch.dispatch(kernel, {{"previous", zeros}, {"values", values}}, {1}, CountPush{16});
    }
  });
  EXPECT_EQ(values.mapped_as<std::int32_t>()[15], steps);
}

// A batch that is dropped while the device works on it waits for the device.
TEST_F(BatchTest, DestroyingABatchInFlightIsSafe) {
  const Buffer buffer(context(), 1 << 22, Memory::Readback, "buffer");
  {
    Batch batch(context(), "dropped");
    for (std::uint32_t word = 0; word < 8; ++word) {
      batch.fill(buffer, word);
    }
    batch.finish();
    ASSERT_EQ(batch.submit(), Outcome::Done);
  }
  EXPECT_EQ(buffer.mapped_as<std::uint32_t>().back(), 7U);
}

// The work is doubled until the device is not done with it by the time the host looks.
TEST_F(BatchTest, AWaitThatIsTooShortSaysSoAndCanGoOn) {
  constexpr std::uint32_t count = 1 << 20;
  const Buffer zeros(context(), count * 4, Memory::Device, "zeros");
  const Buffer values(context(), count * 4, Memory::Device, "values");
  const Kernel kernel = accumulate();
  Batch batch(context(), "long");
  Outcome outcome = Outcome::Done;
  for (int steps = 16; outcome == Outcome::Done && steps <= 4096; steps *= 2) {
    for (int step = 0; step < steps; ++step) {
      batch.dispatch(kernel, {{"previous", zeros}, {"values", values}}, {groups_for(count, 64)},
                     CountPush{count});
    }
    batch.finish();
    ASSERT_EQ(batch.submit(), Outcome::Done);
    outcome = batch.wait(std::chrono::nanoseconds(0));
    if (outcome == Outcome::Done) {
      batch.reset();
    }
  }
  EXPECT_EQ(outcome, Outcome::TimedOut) << describe(outcome);
  EXPECT_TRUE(batch.in_flight());
  EXPECT_EQ(batch.wait(), Outcome::Done);
  EXPECT_FALSE(batch.in_flight());
}

// Several threads may have batches of their own on one context.
TEST_F(BatchTest, ThreadsShareAContext) {
  constexpr int rounds = 50;
  std::vector<std::thread> threads;
  std::array<int, 4> right{};
  for (std::size_t index = 0; index < right.size(); ++index) {
    threads.emplace_back([this, index, &right] {
      const Buffer buffer(context(), 4096, Memory::Readback, "of one thread");
      const auto word = static_cast<std::uint32_t>(index + 1);
      Batch batch(context(), "of one thread");
      batch.fill(buffer, word);
      batch.finish();
      for (int round = 0; round < rounds; ++round) {
        const bool ran = batch.submit() == Outcome::Done && batch.wait() == Outcome::Done;
        right[index] += ran && buffer.mapped_as<std::uint32_t>()[1023] == word ? 1 : 0;
      }
    });
  }
  for (std::thread& thread : threads) {
    thread.join();
  }
  EXPECT_THAT(right, ::testing::Each(rounds));
}

}  // namespace
}  // namespace facet::gpu
