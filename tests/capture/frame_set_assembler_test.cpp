#include "capture/frame_set_assembler.hpp"

#include <gtest/gtest.h>

#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <thread>
#include <vector>

#include "facet/clock.hpp"
#include "support/set_clock.hpp"
#include "virtual_rig.hpp"

namespace facet::capture {
namespace {

using namespace std::chrono_literals;
using Outcome = FrameSetAssembler::Outcome;

/// Says how far a thread has come.
class Progress {
 public:
  void reach(std::int64_t count) {
    const std::lock_guard lock(mutex_);
    count_ = count;
    changed_.notify_all();
  }
  void wait_for(std::int64_t count) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return count_ >= count; });
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::int64_t count_ = 0;
};

/// A trigger, three cameras and a consumer, each on a thread; the clock is the trigger's.
TEST(FrameSetAssembler, SetsOfManyThreadsAreOfOneSlot) {
  constexpr std::int64_t kSlots = 500;
  constexpr std::int64_t kBegin_ns = 1'000'000'000;
  CaptureConfig config = rig(3);
  config.period_ns = kMillisecond;
  config.deadline_ns = 30 * kMillisecond;
  config.open_sets = 16;
  test::SetClock clock(kBegin_ns);
  FrameSetAssembler assembler(config);
  const auto time_of = [](std::int64_t slot) { return kBegin_ns + slot * kMillisecond; };
  Progress fired;
  Progress taken;
  std::vector<std::thread> threads;
  threads.emplace_back([&] {
    for (std::int64_t slot = 0; slot < kSlots; ++slot) {
      taken.wait_for(slot - 10);
      clock.set(time_of(slot));
      assembler.fired(static_cast<std::uint64_t>(slot), time_of(slot));
      fired.reach(slot + 1);
    }
  });
  for (std::size_t camera = 0; camera < 3; ++camera) {
    threads.emplace_back([&, camera] {
      for (std::int64_t slot = 0; slot < kSlots; ++slot) {
        fired.wait_for(slot + 1);
        const auto number = static_cast<std::uint64_t>(slot);
        assembler.push(camera, painted(number, number + camera, time_of(slot)));
      }
    });
  }
  FrameSet set;
  for (std::int64_t slot = 0; slot < kSlots; ++slot) {
    ASSERT_EQ(assembler.next(set, 60s), Outcome::Delivered);
    EXPECT_EQ(set.slot, static_cast<std::uint64_t>(slot));
    EXPECT_EQ(set.missing, slot < 7 ? 0b111U : 0U);
    for (const Frame& frame : set.frames) {
      EXPECT_TRUE(frame.empty() || slot_in(frame) == set.slot);
    }
    taken.reach(slot + 1);
  }
  for (std::thread& thread : threads) {
    thread.join();
  }
  EXPECT_EQ(assembler.statistics().complete, static_cast<std::uint64_t>(kSlots - 7));
}

TEST(FrameSetAssembler, TheDeadlineWakesTheConsumer) {
  CaptureConfig config = rig(2);
  config.period_ns = kMillisecond;
  config.deadline_ns = kMillisecond;
  FrameSetAssembler assembler(config);
  assembler.fired(7, Clock::now_ns());
  FrameSet set;
  ASSERT_EQ(assembler.next(set, 60s), Outcome::Delivered);
  EXPECT_EQ(set.slot, 7U);
  EXPECT_EQ(set.missing, 0b11U);
  EXPECT_EQ(assembler.next(set, 0ms), Outcome::Timeout);
}

TEST(FrameSetAssembler, TheDeadlineIsTheInstalledClocks) {
  CaptureConfig config = rig(2);
  config.period_ns = kMillisecond;
  config.deadline_ns = kMillisecond;
  test::SetClock clock(1'000'000'000);
  FrameSetAssembler assembler(config);
  assembler.fired(7, Clock::now_ns());
  FrameSet set;
  EXPECT_EQ(assembler.next(set, 0ms), Outcome::Timeout);
  std::this_thread::sleep_for(3ms);
  EXPECT_EQ(assembler.next(set, 0ms), Outcome::Timeout);
  clock.set(1'000'000'000 + kMillisecond);
  ASSERT_EQ(assembler.next(set, 0ms), Outcome::Delivered);
  EXPECT_EQ(set.slot, 7U);
}

TEST(FrameSetAssembler, CloseEndsTheWaiting) {
  FrameSetAssembler assembler(rig(2));
  std::thread closer([&] { assembler.close(); });
  FrameSet set;
  EXPECT_EQ(assembler.next(set, 60s), Outcome::Closed);
  closer.join();
}

}  // namespace
}  // namespace facet::capture
