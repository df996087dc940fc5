#include "capture/frame_set_matcher.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <numeric>
#include <optional>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "virtual_rig.hpp"

namespace facet::capture {
namespace {

using ::testing::HasSubstr;

constexpr std::int64_t kPeriod_ns = 16'666'667;
constexpr std::int64_t kTransport_ns = 12 * kMillisecond;
constexpr std::int64_t kBegin_ns = 1'000'000'000;

std::uint64_t refused(const FrameSetMatcher& matcher, std::size_t camera, Refusal cause) {
  return matcher.statistics().cameras[camera].refused.at(static_cast<std::size_t>(cause));
}

std::uint64_t refused_at_all(const CameraMatch& camera) {
  return std::accumulate(camera.refused.begin(), camera.refused.end(), std::uint64_t{0});
}

/// Two cameras fired at exact times, told one event at a time.
class TwoCameras : public ::testing::Test {
 protected:
  static std::int64_t time_of(std::uint64_t slot) {
    return kBegin_ns + static_cast<std::int64_t>(slot) * kPeriod_ns;
  }
  void fire(std::uint64_t slot) { matcher_.fired(slot, time_of(slot)); }
  /// `wrong_ns`: how far the time stamp is off.
  void frame(std::size_t camera, std::uint64_t slot, std::uint64_t sequence, std::int64_t wrong_ns = 0) {
    matcher_.push(camera, painted(slot, sequence, time_of(slot) + wrong_ns), time_of(slot) + kTransport_ns);
  }
  /// Whole slots, both cameras counting from the slot.
  void play(std::uint64_t from, std::uint64_t to) {
    for (std::uint64_t slot = from; slot < to; ++slot) {
      fire(slot);
      frame(0, slot, slot);
      frame(1, slot, slot);
    }
  }
  /// Takes all that is ready at the time a slot's frames have arrived.
  std::vector<FrameSet> sets(std::uint64_t slot) {
    std::vector<FrameSet> found;
    const std::int64_t now_ns = time_of(slot) + kTransport_ns;
    matcher_.advance(now_ns);
    for (FrameSet set; matcher_.take(set, now_ns);) {
      found.push_back(set);
    }
    return found;
  }
  /// Slots 0 to 9; then both are in step and nothing is open.
  void settle() {
    play(0, 8);
    sets(7);
    play(8, 10);
    sets(9);
    ASSERT_EQ(matcher_.statistics().complete, 3U);
    ASSERT_EQ(matcher_.statistics().incomplete, kFirst);
  }
  static constexpr std::uint64_t kFirst = 7;  ///< frames of each camera that only bring it into step

  FrameSetMatcher matcher_{rig(2)};
};

TEST_F(TwoCameras, TheFirstFramesOnlyShowThatTimeAndNumbersAgree) {
  play(0, 8);
  const std::vector<FrameSet> found = sets(8);
  ASSERT_EQ(found.size(), 8U);
  for (std::uint64_t slot = 0; slot < 8; ++slot) {
    EXPECT_EQ(found[slot].slot, slot);
    EXPECT_EQ(found[slot].trigger_ns, time_of(slot));
    EXPECT_EQ(found[slot].missing, slot < kFirst ? 0b11U : 0U);
  }
  EXPECT_EQ(refused(matcher_, 0, Refusal::SequenceDisagrees), kFirst);
  EXPECT_TRUE(matcher_.statistics().cameras[0].in_step);
}

TEST_F(TwoCameras, ASetWaitsForItsFramesUntilTheDeadline) {
  settle();
  fire(10);
  frame(0, 10, 10);
  EXPECT_TRUE(sets(10).empty());
  EXPECT_EQ(matcher_.next_deadline_ns(), time_of(10) + 100 * kMillisecond);
  FrameSet set;
  EXPECT_FALSE(matcher_.take(set, time_of(10) + 100 * kMillisecond - 1));
  ASSERT_TRUE(matcher_.take(set, time_of(10) + 100 * kMillisecond));
  EXPECT_EQ(set.missing, 0b10U);
  EXPECT_TRUE(set.frames[1].empty());
  EXPECT_EQ(slot_in(set.frames[0]), 10U);
  frame(1, 10, 10);
  EXPECT_EQ(refused(matcher_, 1, Refusal::TooLate), 1U);
}

TEST_F(TwoCameras, ACountedLossIsMissingAtOnce) {
  settle();
  play(10, 11);
  fire(11);
  frame(0, 11, 11);
  fire(12);
  frame(0, 12, 12);
  frame(1, 12, 12);
  const std::vector<FrameSet> found = sets(12);
  ASSERT_EQ(found.size(), 3U);
  EXPECT_EQ(found[1].missing, 0b10U);
  EXPECT_TRUE(found[2].complete());
  EXPECT_EQ(matcher_.statistics().cameras[1].lost, 1U);
  EXPECT_EQ(matcher_.statistics().cameras[1].missing, kFirst + 1);
}

TEST_F(TwoCameras, MoreRefusedThanFiredIsNoNegativeLoss) {
  settle();
  fire(10);
  fire(11);
  for (const std::uint64_t wrong : {15U, 16U, 17U}) {
    frame(0, 11, wrong);
  }
  fire(12);
  frame(0, 12, 12);
  EXPECT_EQ(refused(matcher_, 0, Refusal::SequenceDisagrees), kFirst + 3);
  EXPECT_TRUE(matcher_.statistics().cameras[0].in_step);
  EXPECT_EQ(matcher_.statistics().cameras[0].lost, 0U);
}

TEST_F(TwoCameras, FramesMayComeBeforeTheirFiringIsTold) {
  settle();
  frame(0, 10, 10);
  frame(1, 10, 10);
  EXPECT_TRUE(sets(10).empty());
  fire(10);
  ASSERT_EQ(sets(10).size(), 1U);
}

TEST_F(TwoCameras, FramesThatNobodyFiredAreRefusedInTime) {
  settle();
  frame(0, 10, 10);
  matcher_.advance(time_of(10) + kTransport_ns + 99 * kMillisecond);
  EXPECT_EQ(refused(matcher_, 0, Refusal::NoSlot), 0U);
  matcher_.advance(time_of(10) + kTransport_ns + 100 * kMillisecond);
  EXPECT_EQ(refused(matcher_, 0, Refusal::NoSlot), 1U);
  for (std::uint64_t i = 0; i < 12; ++i) {
    frame(1, 20 + i, 20 + i);
  }
  EXPECT_EQ(refused(matcher_, 1, Refusal::Overrun), 4U);
}

/// A time stamp that is wrong by one period fits the next slot in every respect but its number.
TEST_F(TwoCameras, ATimeStampWrongByOnePeriodIsRefused) {
  settle();
  fire(10);
  fire(11);
  matcher_.push(0, painted(10, 10, time_of(11)), time_of(11) + kMillisecond);
  EXPECT_EQ(refused(matcher_, 0, Refusal::SequenceDisagrees), kFirst + 1);
  EXPECT_FALSE(matcher_.statistics().cameras[0].in_step);
  frame(0, 11, 11);
  EXPECT_TRUE(matcher_.statistics().cameras[0].in_step);
  EXPECT_EQ(matcher_.statistics().cameras[0].in_sets, 4U);
}

/// All later time stamps too: numbers, times and firings look as if the camera had missed one firing, but the
/// frames arrive too soon.
TEST_F(TwoCameras, TimeStampsThatJumpByOnePeriodKeepTheCameraOut) {
  settle();
  fire(10);
  for (std::uint64_t slot = 10; slot < 106; ++slot) {
    fire(slot + 1);
    matcher_.push(0, painted(slot, slot, time_of(slot + 1)), time_of(slot) + kPeriod_ns);
    frame(1, slot, slot);
    sets(slot);
  }
  EXPECT_EQ(matcher_.statistics().cameras[0].in_sets, 3U) << "none since the jump";
  EXPECT_EQ(refused(matcher_, 0, Refusal::SequenceDisagrees), kFirst + 96);
}

TEST_F(TwoCameras, AMissedFiringCostsThreeFramesAndNoSetIsWrong) {
  settle();
  for (std::uint64_t slot = 10; slot < 16; ++slot) {
    fire(slot);
    frame(0, slot, slot);
    if (slot != 10) {
      frame(1, slot, slot - 1);
    }
    for (const FrameSet& set : sets(slot)) {
      EXPECT_EQ(slot_in(set.frames[0]), set.slot);
      EXPECT_EQ(set.missing, set.slot < 13 ? 0b10U : 0U);
      if (set.complete()) {
        EXPECT_EQ(slot_in(set.frames[1]), set.slot);
      }
    }
  }
  EXPECT_EQ(matcher_.statistics().complete, 3U + 3U);
  EXPECT_EQ(refused(matcher_, 1, Refusal::SequenceDisagrees), kFirst + 2);
}

TEST_F(TwoCameras, DoubleDamagedAndFarOffFramesAreRefusedByName) {
  settle();
  fire(10);
  frame(0, 10, 10);
  frame(0, 10, 10);
  EXPECT_EQ(refused(matcher_, 0, Refusal::Duplicate), 1U);
  Frame damaged = painted(10, 10, time_of(10));
  damaged.corrupt = true;
  matcher_.push(1, damaged, time_of(10) + kTransport_ns);
  EXPECT_EQ(refused(matcher_, 1, Refusal::Corrupt), 1U);
  EXPECT_EQ(sets(10).size(), 1U) << "the damaged frame was the one";
  fire(11);
  frame(0, 11, 11, -kPeriod_ns / 3);
  EXPECT_EQ(refused(matcher_, 0, Refusal::TimeDisagrees), 1U);
  matcher_.push(0, painted(11, 12, time_of(11) - 500 * kMillisecond), time_of(11) + kTransport_ns);
  EXPECT_EQ(refused(matcher_, 0, Refusal::NoSlot), 1U);
  matcher_.push(0, painted(11, 13, time_of(11) + 500 * kMillisecond), time_of(11) + kTransport_ns);
  EXPECT_EQ(refused(matcher_, 0, Refusal::TimeDisagrees), 2U) << "exposed after it arrived";
}

TEST_F(TwoCameras, WhoDoesNotStreamIsNotWaitedFor) {
  settle();
  matcher_.set_streaming(1, false);
  fire(10);
  frame(0, 10, 10);
  const std::vector<FrameSet> found = sets(10);
  ASSERT_EQ(found.size(), 1U);
  EXPECT_EQ(found[0].missing, 0b10U);
  matcher_.set_streaming(1, true);
  fire(11);
  frame(0, 11, 11);
  EXPECT_TRUE(sets(11).empty());
}

TEST_F(TwoCameras, ASlowConsumerLosesTheOldestSets) {
  settle();
  play(10, 30);
  const std::vector<FrameSet> found = sets(30);
  ASSERT_EQ(found.size(), 8U);
  EXPECT_EQ(found.front().slot, 22U);
  EXPECT_EQ(matcher_.statistics().dropped, 12U);
}

TEST_F(TwoCameras, FiringsThatDoNotGrowAreIgnored) {
  fire(5);
  fire(5);
  matcher_.fired(6, time_of(4));
  EXPECT_EQ(matcher_.statistics().odd_slots, 2U);
  EXPECT_EQ(matcher_.statistics().slots, 1U);
}

TEST_F(TwoCameras, OffsetJitterAndSkewAreLearned) {
  std::mt19937 random(5);
  std::normal_distribution<double> jitter(0, 200e3);
  for (std::uint64_t slot = 0; slot < 1000; ++slot) {
    fire(slot);
    frame(0, slot, slot, 2 * kMillisecond + std::llround(jitter(random)));
    frame(1, slot, slot, -1 * kMillisecond);
    sets(slot);
  }
  const CaptureStatistics& statistics = matcher_.statistics();
  EXPECT_NEAR(statistics.cameras[0].offset_ns, 2e6, 100e3);
  EXPECT_NEAR(statistics.cameras[0].jitter_ns, 200e3, 80e3);
  EXPECT_NEAR(statistics.cameras[1].offset_ns, -1e6, 1e3);
  EXPECT_LT(statistics.cameras[1].jitter_ns, 1e3);
  EXPECT_NEAR(statistics.cameras[0].skew_ns, 1.5e6, 100e3);
  EXPECT_NEAR(statistics.cameras[1].skew_ns, -1.5e6, 100e3);
  EXPECT_NEAR(statistics.cameras[0].transport_ns, 10e6, 100e3);
  EXPECT_GT(statistics.worst_skew_ns, 400'000);
  EXPECT_FALSE(statistics.cameras[0].offset_odd);
}

/// A clock that runs away is followed for a quarter of the period, then the camera is out.
TEST_F(TwoCameras, AClockThatRunsAwayIsNoticed) {
  bool odd = false;
  for (std::uint64_t slot = 0; slot < 2000; ++slot) {
    fire(slot);
    frame(0, slot, slot);
    frame(1, slot, slot, static_cast<std::int64_t>(slot) * 10 * kMicrosecond);
    for (const FrameSet& set : sets(slot)) {
      for (const Frame& frame : set.frames) {
        ASSERT_TRUE(frame.empty() || slot_in(frame) == set.slot);
      }
    }
    odd = odd || matcher_.statistics().cameras[1].offset_odd;
  }
  EXPECT_TRUE(odd);
  EXPECT_GT(refused(matcher_, 1, Refusal::TimeDisagrees), 200U);
  EXPECT_GT(matcher_.statistics().cameras[1].in_sets, 600U);
  EXPECT_LT(matcher_.statistics().cameras[1].in_sets, 1000U);
}

TEST(FrameSetConfig, SaysWhatCannotBe) {
  const auto complaint = [](const std::function<void(CaptureConfig&)>& spoil) -> std::string {
    CaptureConfig config = rig(2);
    spoil(config);
    try {
      const FrameSetMatcher matcher(config);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(complaint([](auto&) {}), "");
  EXPECT_EQ(complaint([](auto& c) { c = rig(64); }), "");
  EXPECT_THAT(complaint([](auto& c) { c = rig(65); }), HasSubstr("not 65"));
  EXPECT_THAT(complaint([](auto& c) { c.cameras.clear(); }), HasSubstr("not 0"));
  EXPECT_THAT(complaint([](auto& c) { c.period_ns = 0; }), HasSubstr("period"));
  EXPECT_THAT(complaint([](auto& c) { c.deadline_ns = 1000; }), HasSubstr("deadline (1 us)"));
  EXPECT_THAT(complaint([](auto& c) { c.open_sets = 1; }), HasSubstr("1 open sets"));
}

struct Tally {
  std::uint64_t complete = 0;
  std::uint64_t used = 0;
};

/// Plays a rig and checks what must always hold: sets come in order, every frame in them is of their own
/// slot, and every firing and frame is accounted for.
Tally check_rig(std::uint64_t seed, const Faults& faults, int slot_count = 400) {
  SCOPED_TRACE(::testing::Message() << "seed " << seed);
  std::mt19937_64 random(seed);
  const std::size_t camera_count = 1 + random() % 6;
  CaptureConfig config = rig(camera_count);
  config.open_sets = 16;
  FrameSetMatcher matcher(config);
  Tally tally;
  std::int64_t last_slot = -1;
  FrameSet set;
  const auto drain = [&](std::int64_t now_ns) {
    matcher.advance(now_ns);
    while (matcher.take(set, now_ns)) {
      EXPECT_GT(static_cast<std::int64_t>(set.slot), last_slot);
      last_slot = static_cast<std::int64_t>(set.slot);
      tally.complete += set.complete() ? 1 : 0;
      for (std::size_t camera = 0; camera < camera_count; ++camera) {
        const bool missing = (set.missing >> camera & 1) != 0;
        EXPECT_EQ(set.frames[camera].empty(), missing);
        if (!missing) {
          EXPECT_EQ(slot_in(set.frames[camera]), set.slot) << "camera " << camera;
        }
      }
    }
  };
  std::vector<std::uint64_t> pushed(camera_count);
  std::uint64_t fired = 0;
  std::int64_t now_ns = 0;
  for (const Happening& happening : play(random, camera_count, slot_count, kPeriod_ns, faults)) {
    now_ns = happening.at_ns;
    if (happening.camera < 0) {
      matcher.fired(happening.slot, happening.fired_ns);
      ++fired;
    } else {
      matcher.push(static_cast<std::size_t>(happening.camera), happening.frame, now_ns);
      ++pushed[static_cast<std::size_t>(happening.camera)];
    }
    drain(now_ns);
  }
  drain(now_ns + 2 * config.deadline_ns);
  const CaptureStatistics& statistics = matcher.statistics();
  EXPECT_EQ(statistics.odd_slots, 0U);
  EXPECT_EQ(statistics.slots, fired);
  EXPECT_EQ(statistics.complete + statistics.incomplete + statistics.dropped, fired);
  EXPECT_EQ(statistics.complete, tally.complete);
  EXPECT_EQ(statistics.dropped, 0U);
  for (std::size_t camera = 0; camera < camera_count; ++camera) {
    const CameraMatch& match = statistics.cameras[camera];
    EXPECT_EQ(match.in_sets + refused_at_all(match), pushed[camera]);
    EXPECT_EQ(match.in_sets + match.missing, fired);
    tally.used += match.in_sets;
  }
  return tally;
}

TEST(FrameSetProperty, WithoutFaultsAllButTheFirstSetsAreComplete) {
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    EXPECT_EQ(check_rig(seed, {}).complete, 400U - 7);
  }
}

TEST(FrameSetProperty, LossesOfAllKindsNeverShiftAFrame) {
  Faults faults;
  faults.dropped_slot = 0.02;
  faults.counted_loss = 0.05;
  faults.uncounted_loss = 0.02;
  faults.burst = 0.002;
  faults.spurious = 0.01;
  faults.duplicate = 0.02;
  faults.corrupt = 0.02;
  faults.number_restart = 0.002;
  faults.arrival_jitter_ns = 12 * kMillisecond;
  std::uint64_t used = 0;
  for (std::uint64_t seed = 100; seed < 300; ++seed) {
    used += check_rig(seed, faults).used;
  }
  EXPECT_GT(used, 100'000U);
}

TEST(FrameSetProperty, CamerasFarBehindEachOtherAreMatched) {
  Faults faults;
  faults.counted_loss = 0.1;
  faults.arrival_jitter_ns = 45 * kMillisecond;
  std::uint64_t used = 0;
  for (std::uint64_t seed = 300; seed < 400; ++seed) {
    used += check_rig(seed, faults).used;
  }
  EXPECT_GT(used, 80'000U);
}

TEST(FrameSetProperty, WrongTimeStampsNeverShiftAFrame) {
  Faults faults;
  faults.counted_loss = 0.03;
  faults.time_outlier = 0.02;
  faults.number_restart = 0.001;
  std::uint64_t used = 0;
  for (std::uint64_t seed = 400; seed < 600; ++seed) {
    used += check_rig(seed, faults).used;
  }
  EXPECT_GT(used, 100'000U);
}

TEST(FrameSetProperty, TimeStampsThatJumpForGoodNeverShiftAFrame) {
  Faults faults;
  faults.counted_loss = 0.03;
  faults.spurious = 0.005;
  faults.permanent_jump = true;
  faults.number_restart = 0.002;
  std::uint64_t used = 0;
  for (std::uint64_t seed = 600; seed < 800; ++seed) {
    used += check_rig(seed, faults).used;
  }
  EXPECT_GT(used, 50'000U) << "up to the jump frames are used";
}

/// Three cameras without a trigger, each with a phase and a rate of its own. `present` says which deliver.
struct FreeRun {
  std::array<std::int64_t, 3> phase_ns{0, 3 * kMillisecond, -4 * kMillisecond};
  std::function<bool(std::size_t camera, int i)> present = [](auto, auto) { return true; };
};

std::vector<FrameSet> free_run(const FreeRun& run, int frames, CaptureStatistics& statistics) {
  CaptureConfig config = rig(3);
  config.synchronisation = Synchronisation::FreeRunning;
  FrameSetMatcher matcher(config);
  std::vector<Happening> happenings;
  for (std::size_t camera = 0; camera < 3; ++camera) {
    for (int i = 0; i < frames; ++i) {
      if (run.present(camera, i)) {
        const std::int64_t time_ns = kBegin_ns + i * kPeriod_ns + run.phase_ns.at(camera);
        const auto number = static_cast<std::uint64_t>(i);
        happenings.push_back(
            {time_ns + kTransport_ns, static_cast<int>(camera), number, 0, painted(number, number, time_ns)});
      }
    }
  }
  std::stable_sort(happenings.begin(), happenings.end(),
                   [](const Happening& a, const Happening& b) { return a.at_ns < b.at_ns; });
  std::vector<FrameSet> found;
  const auto drain = [&](std::int64_t now_ns) {
    matcher.advance(now_ns);
    for (FrameSet set; matcher.take(set, now_ns);) {
      found.push_back(set);
    }
  };
  for (const Happening& happening : happenings) {
    matcher.push(static_cast<std::size_t>(happening.camera), happening.frame, happening.at_ns);
    drain(happening.at_ns);
  }
  drain(happenings.back().at_ns + 2 * config.deadline_ns);
  statistics = matcher.statistics();
  return found;
}

void expect_one_exposure(const FrameSet& set) {
  std::optional<std::uint64_t> first;
  for (const Frame& frame : set.frames) {
    if (!frame.empty()) {
      EXPECT_EQ(slot_in(frame), first.value_or(slot_in(frame))) << "set " << set.slot;
      first = slot_in(frame);
    }
  }
}

TEST(FreeRunning, FramesAreMatchedByTimeWithinHalfAPeriod) {
  CaptureStatistics statistics;
  const std::vector<FrameSet> found = free_run({}, 200, statistics);
  // Camera 2 is ahead of camera 0: its first frame waits for a slot like all others.
  ASSERT_EQ(found.size(), 200U);
  for (const FrameSet& set : found) {
    EXPECT_TRUE(set.complete()) << "set " << set.slot;
    expect_one_exposure(set);
    EXPECT_EQ(set.skew_ns, 7 * kMillisecond);
  }
  EXPECT_NEAR(statistics.cameras[1].offset_ns, 3e6, 1e5);
}

TEST(FreeRunning, LostFramesOfTheReferenceLeaveTheirSlot) {
  FreeRun run;
  run.present = [](std::size_t camera, int i) { return camera != 0 || i % 10 != 5; };
  CaptureStatistics statistics;
  const std::vector<FrameSet> found = free_run(run, 200, statistics);
  ASSERT_EQ(found.size(), 200U);
  for (const FrameSet& set : found) {
    EXPECT_EQ(set.missing, set.slot % 10 == 5 ? 0b001U : 0U) << "set " << set.slot;
    expect_one_exposure(set);
  }
}

TEST(FreeRunning, AnotherCameraLeadsWhereTheReferenceFallsSilent) {
  FreeRun run;
  run.present = [](std::size_t camera, int i) { return camera != 0 || i < 50 || i >= 120; };
  CaptureStatistics statistics;
  const std::vector<FrameSet> found = free_run(run, 200, statistics);
  std::uint64_t complete = 0;
  std::uint64_t pairs = 0;
  for (const FrameSet& set : found) {
    expect_one_exposure(set);
    complete += set.complete() ? 1 : 0;
    pairs += set.missing == 0b001U ? 1 : 0;
  }
  EXPECT_GE(complete, 125U);
  EXPECT_GE(pairs, 60U);
  EXPECT_GE(statistics.cameras[0].in_sets, 125U);
}

}  // namespace
}  // namespace facet::capture
