#include "trigger/runner.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>
#include <set>

#include "bench_of_lines.hpp"

namespace facet::trigger {
namespace {

using Kind = TriggerEvent::Kind;

constexpr LineMask kLeft = 0b0001;
constexpr LineMask kRight = 0b0010;
constexpr LineMask kA = 0b0100;
constexpr LineMask kB = 0b1000;
constexpr std::int64_t kSlot_ns = 10 * kMillisecond;

/// When the first slot of a run that began at time_ns = 1 s is due.
constexpr std::int64_t kFirst_ns = 1'020'000'000;

TEST(TriggerRunner, SetsPatternFiresTogetherAndReleases) {
  const TriggerProgram program = two_cameras_two_projectors();
  BenchOfLines bench(program);
  ASSERT_TRUE(bench.run(program, 3));
  const std::vector<LineMask> levels = {
      kA,
      kA | kLeft | kRight,
      kA | kRight,
      kB,  // slot 0: pattern A; B rests active
      kB | kLeft | kRight,
      kB | kRight,
      kB,  // slot 1: pattern B is what rests
      0,
      kLeft | kRight,
      kRight,
      kB,  // slot 2: blank
  };
  ASSERT_EQ(bench.changes.size(), levels.size());
  for (std::size_t i = 0; i < levels.size(); ++i) {
    EXPECT_EQ(bench.changes[i].level, levels[i]) << "change " << i;
  }
  // Times of slot 0. What waits for an edge that came 3 us late keeps its full length.
  EXPECT_EQ(bench.changes[0].time_ns, kFirst_ns + 3 * kMicrosecond);
  EXPECT_EQ(bench.changes[1].time_ns, kFirst_ns + kMillisecond + 6 * kMicrosecond);
  EXPECT_EQ(bench.changes[2].time_ns, bench.changes[1].time_ns + kMillisecond + 3 * kMicrosecond);
  EXPECT_EQ(bench.changes[3].time_ns, bench.changes[1].time_ns + 5 * kMillisecond + 3 * kMicrosecond);
}

TEST(TriggerRunner, LatenessNeverAddsUp) {
  TriggerProgram program = two_cameras_two_projectors();
  program.slots_per_second = 60;
  BenchOfLines bench(program);
  ASSERT_TRUE(bench.run(program, 100'000));
  const std::vector<TriggerEvent> fired = bench.events_of(Kind::Fired);
  ASSERT_EQ(fired.size(), 100'000U);
  for (const TriggerEvent& event : fired) {
    const auto due_ns = kFirst_ns + kMillisecond + static_cast<std::int64_t>(event.slot) * 1'000'000'000 / 60;
    ASSERT_NEAR(static_cast<double>(event.planned_ns - due_ns), 0, 1);
    ASSERT_LE(event.actual_ns - event.planned_ns, 6 * kMicrosecond);
    ASSERT_EQ(event.call_ns, 3 * kMicrosecond);
  }
  EXPECT_EQ(bench.counters.slots_dropped, 0U);
  EXPECT_EQ(bench.counters.edges_late, 0U);
}

TEST(TriggerRunner, ASlotThatCannotStartInTimeIsLeftOutWhole) {
  const TriggerProgram program = two_cameras_two_projectors();
  BenchOfLines bench(program);
  bench.stalls = {{kFirst_ns + 2 * kSlot_ns - kMillisecond, 31 * kMillisecond}};  // until slot 5 is due
  ASSERT_TRUE(bench.run(program, 4, 100));
  const std::vector<TriggerEvent> dropped = bench.events_of(Kind::Dropped);
  ASSERT_EQ(dropped.size(), 1U);
  EXPECT_EQ(dropped[0].slot, 102U);
  EXPECT_EQ(dropped[0].slot_count, 3U);
  EXPECT_EQ(dropped[0].planned_ns, kFirst_ns + 2 * kSlot_ns);
  std::vector<std::uint64_t> slots;
  for (const TriggerEvent& event : bench.events_of(Kind::Fired)) {
    slots.push_back(event.slot);
  }
  EXPECT_EQ(slots, (std::vector<std::uint64_t>{100, 101, 105, 106}));
  EXPECT_EQ(bench.counters.slots_dropped, 3U);
}

TEST(TriggerRunner, AStallBeforeTheFiringLeavesTheCamerasAlone) {
  const TriggerProgram program = two_cameras_two_projectors();
  BenchOfLines bench(program);
  bench.stalls = {{kFirst_ns + 500 * kMicrosecond, 3 * kMillisecond}};
  ASSERT_TRUE(bench.run(program, 1));
  EXPECT_EQ(bench.events_of(Kind::Dropped).size(), 1U);
  ASSERT_EQ(bench.events_of(Kind::Fired).size(), 1U);
  EXPECT_EQ(bench.events_of(Kind::Fired)[0].slot, 1U);
  ASSERT_GE(bench.changes.size(), 2U);
  EXPECT_EQ(bench.changes[0].level, kA);
  EXPECT_EQ(bench.changes[1].level, kB) << "back to rest at once";
}

TEST(TriggerRunner, AStallDuringTheExposureLengthensItAndIsCounted) {
  const TriggerProgram program = two_cameras_two_projectors();
  BenchOfLines bench(program);
  bench.stalls = {{kFirst_ns + 2500 * kMicrosecond, 20 * kMillisecond}};
  ASSERT_TRUE(bench.run(program, 2));
  EXPECT_EQ(bench.counters.edges_late, 3U) << "projectors a and b, camera.right";
  EXPECT_EQ(bench.counters.slots_dropped, 2U) << "those that were due meanwhile";
  EXPECT_GT(bench.counters.worst_late_ns, 15 * kMillisecond);
}

TEST(TriggerRunner, ReadBackProvesEdgesAndNamesMissingAndStrayOnes) {
  const TriggerProgram program = two_cameras_two_projectors();
  BenchOfLines bench(program);
  bench.proven_lines = kLeft;
  bench.unproven = [](std::uint8_t, std::int64_t time_ns) {
    return time_ns > kFirst_ns + 3 * kSlot_ns && time_ns < kFirst_ns + 4 * kSlot_ns;
  };
  bench.seen_edges = {{0, true, kFirst_ns - kMillisecond}};  // before anything was set
  ASSERT_TRUE(bench.run(program, 10));
  EXPECT_EQ(bench.counters.edges_proven, 18U);
  EXPECT_EQ(bench.counters.edges_missing, 2U);
  EXPECT_EQ(bench.counters.edges_stray, 1U);
  for (const TriggerEvent& event : bench.events_of(Kind::Missing)) {
    EXPECT_EQ(event.slot, 3U);
    EXPECT_EQ(event.line, 0U);
  }
  for (const TriggerEvent& event : bench.events_of(Kind::Seen)) {
    EXPECT_NE(event.slot, 3U);
    EXPECT_EQ(event.actual_ns - event.planned_ns, 43 * kMicrosecond);
  }
}

TEST(TriggerRunner, LinesThatFailEndTheRun) {
  const TriggerProgram program = two_cameras_two_projectors();
  BenchOfLines bench(program);
  bench.broken_from_ns = kFirst_ns + 5 * kSlot_ns;
  EXPECT_FALSE(bench.run(program, 10));
  EXPECT_EQ(bench.events_of(Kind::Fired).size(), 5U);
}

TEST(TriggerRunner, StopEndsWithTheLinesAtRest) {
  const TriggerProgram program = two_cameras_two_projectors();
  for (std::uint64_t slots = 1; slots <= 6; ++slots) {
    BenchOfLines bench(program);
    ASSERT_TRUE(bench.run(program, slots));
    EXPECT_EQ(bench.level, safe_lines(program));
    EXPECT_EQ(bench.counters.slots_fired, slots);
  }
}

/// Whatever stalls: every number is fired once or dropped once, in order; all camera lines of a fired slot
/// rise within the tolerance and stay for their whole pulse under the slot's own pattern.
TEST(TriggerRunner, EverySlotIsFiredWholeOrDroppedWhole) {
  constexpr std::uint32_t kSeed = 20260101;
  std::mt19937 random(kSeed);
  const TriggerProgram program = two_cameras_two_projectors();
  for (int round = 0; round < 200; ++round) {
    SCOPED_TRACE(::testing::Message() << "seed " << kSeed << ", round " << round);
    BenchOfLines bench(program);
    for (int i = 0; i < 12; ++i) {
      bench.stalls.emplace_back(kFirst_ns + static_cast<std::int64_t>(random() % 400'000'000),
                                static_cast<std::int64_t>(random() % 25'000'000));
    }
    std::sort(bench.stalls.begin(), bench.stalls.end());
    ASSERT_TRUE(bench.run(program, 40, 7));
    std::uint64_t next = 7;
    for (const TriggerEvent& event : bench.events) {
      if (event.kind == Kind::Fired || event.kind == Kind::Dropped) {
        ASSERT_EQ(event.slot, next);
        next += event.slot_count;
      }
      if (event.kind == Kind::Fired) {
        ASSERT_LE(event.actual_ns - event.planned_ns, program.tolerance_ns + 6 * kMicrosecond);
        const auto fired = std::find_if(bench.changes.begin(), bench.changes.end(), [&](const auto& change) {
          return change.time_ns == event.actual_ns;
        });
        ASSERT_NE(fired, bench.changes.end());
        ASSERT_EQ(fired->level, program.patterns[event.slot % 3] | kLeft | kRight);
        ASSERT_GE((fired + 1)->time_ns - fired->time_ns, kMillisecond);
        ASSERT_EQ((fired + 1)->level & kRight, kRight);
        ASSERT_GE((fired + 2)->time_ns - fired->time_ns, 5 * kMillisecond);
        ASSERT_EQ((fired + 2)->level, safe_lines(program));
      }
    }
    ASSERT_EQ(bench.counters.slots_fired + bench.counters.slots_dropped, next - 7);
  }
}

}  // namespace
}  // namespace facet::trigger
