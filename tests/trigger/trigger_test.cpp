// Triggers on real threads and the real clock: what is asserted holds at any speed.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <atomic>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "bench_of_lines.hpp"
#include "facet/error.hpp"
#include "trigger/event_ring.hpp"
#include "trigger/gpio_trigger.hpp"
#include "trigger/real_time.hpp"
#include "trigger/virtual_trigger.hpp"

namespace facet::trigger {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;
using Kind = TriggerEvent::Kind;

/// Takes events until so many slots were fired or dropped; returns their numbers, each once.
std::vector<std::uint64_t> slots_of(Trigger& trigger, std::size_t count) {
  std::vector<std::uint64_t> slots;
  TriggerEvent event;
  while (slots.size() < count && trigger.next(event, 60s)) {
    for (std::uint64_t i = 0;
         i < event.slot_count && (event.kind == Kind::Fired || event.kind == Kind::Dropped); ++i) {
      slots.push_back(event.slot + i);
    }
  }
  return slots;
}

TEST(VirtualTrigger, RunsAndStopsAndGoesOnWithNewNumbers) {
  const TriggerProgram program = two_cameras_two_projectors();
  std::atomic<LineMask> level = 0;
  std::atomic<int> risings = 0;
  VirtualTriggerOptions options;
  options.read_back = 0b0011;
  options.on_change = [&](LineMask active, std::int64_t) {
    risings += (active & ~level.exchange(active) & 0b0001) != 0 ? 1 : 0;
  };
  const auto trigger = make_virtual_trigger(program, options);
  EXPECT_EQ(trigger->status().state, TriggerState::Idle);
  for (const std::uint64_t first : {std::uint64_t{0}, std::uint64_t{1000}}) {
    trigger->start(first);
    const std::vector<std::uint64_t> slots = slots_of(*trigger, 5);
    ASSERT_GE(slots.size(), 5U);
    for (std::size_t i = 0; i < slots.size(); ++i) {
      EXPECT_EQ(slots[i], first + i);
    }
    trigger->request_stop();
    trigger->stop();
    EXPECT_EQ(trigger->status().state, TriggerState::Idle);
    EXPECT_EQ(level, safe_lines(program)) << "at rest";
    TriggerEvent event;
    while (trigger->next(event, 0ms)) {
    }
  }
  const TriggerStatus status = trigger->status();
  EXPECT_EQ(status.slots_fired, static_cast<std::uint64_t>(risings));
  EXPECT_EQ(status.edges_proven + status.edges_missing, 4 * status.slots_fired);
  EXPECT_EQ(status.edges_stray, 0U);
  EXPECT_FALSE(status.real_time);
}

TEST(VirtualTrigger, SaysWhetherItIsRealTime) {
  VirtualTriggerOptions options;
  options.thread.real_time = true;
  const auto trigger = make_virtual_trigger(two_cameras_two_projectors(), options);
  trigger->start(0);
  ASSERT_FALSE(slots_of(*trigger, 1).empty());
  const TriggerStatus status = trigger->status();
  if (status.real_time) {
    EXPECT_EQ(status.scheduling, "SCHED_FIFO 50; memory is locked");
  } else {
    EXPECT_THAT(status.scheduling,
                ::testing::AnyOf(HasSubstr("no real-time priority: "), HasSubstr("memory is not locked: ")));
  }
  EXPECT_THROW(trigger->start(1), Error) << "it runs already";
}

#ifndef FACET_SANITIZED  // the sanitizers keep freed memory back
/// Memory in use, bytes.
std::int64_t resident_bytes() {
  std::int64_t pages = 0;
  std::int64_t resident = 0;
  std::ifstream("/proc/self/statm") >> pages >> resident;
  return resident * ::sysconf(_SC_PAGESIZE);
}

TEST(RealTime, LockedMemoryIsGivenBackOnceItIsFree) {
  // The heap of a thread of its own, as a camera has; pictures are freed by others.
  constexpr std::size_t kPicture_bytes = 640 * 480 * 4;
  const auto burst = [&](std::size_t pictures) {
    std::vector<std::vector<char>> held;
    std::thread([&] {
      for (std::size_t i = 0; i < pictures; ++i) {
        held.emplace_back(kPicture_bytes, 'x');
      }
    }).join();
  };
  RealTime given;
  std::thread([&] { given = become_real_time(1); }).join();
  if (given.description.find("memory is locked") == std::string::npos) {
    GTEST_SKIP() << given.description;
  }
  burst(1);
  const std::int64_t before = resident_bytes();
  burst(40);
  const std::int64_t after = resident_bytes();
  ::munlockall();
  EXPECT_LT(after - before, std::int64_t{4 * kPicture_bytes});
}
#endif

TEST(ThreadedTrigger, LinesThatFailAreAStateWithItsReason) {
  const TriggerProgram program = two_cameras_two_projectors();
  auto lines = std::make_unique<BenchOfLines>(program);
  lines->broken_from_ns = 1;
  const auto trigger = make_threaded_trigger(program, std::move(lines), {.real_time = false});
  trigger->start(0);
  TriggerEvent event;
  while (trigger->status().state == TriggerState::Running) {
    trigger->next(event, 1ms);
  }
  EXPECT_EQ(trigger->status().state, TriggerState::Failing);
  EXPECT_EQ(trigger->status().reason, "cut");
}

TEST(EventRing, KeepsOrderAndCountsWhatDoesNotFit) {
  EventRing ring(4);
  for (std::uint64_t i = 0; i < 7; ++i) {
    ring.put({.slot = i});
  }
  EXPECT_EQ(ring.lost(), 3U);
  TriggerEvent event;
  for (std::uint64_t i = 0; i < 4; ++i) {
    ASSERT_TRUE(ring.take(event, 0ns));
    EXPECT_EQ(event.slot, i);
  }
  EXPECT_FALSE(ring.take(event, 0ns));
  ring.put({.slot = 9});
  ASSERT_TRUE(ring.take(event, 0ns));
  EXPECT_EQ(event.slot, 9U);
}

std::string complaint(const TriggerProgram& program, const GpioTriggerConfig& config, ErrorKind kind) {
  try {
    open_gpio_trigger(program, config);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), kind) << error.what();
    return error.what();
  }
  return "no error";
}

TEST(GpioTrigger, WiringMustFitTheProgram) {
  const TriggerProgram program = two_cameras_two_projectors();
  GpioTriggerConfig config;
  EXPECT_EQ(complaint(program, config, ErrorKind::Usage), "line 'camera.left' has no GPIO output");
  config.outputs = {{.name = "camera.top", .chip = "none", .line = "1"}};
  EXPECT_THAT(complaint(program, config, ErrorKind::Usage), HasSubstr("output of 'camera.top'"));
  config.outputs = {{"camera.left", "none", "1"}, {"camera.left", "none", "2"}};
  EXPECT_EQ(complaint(program, config, ErrorKind::Usage), "line 'camera.left' has two outputs");
}

TEST(GpioTrigger, AMissingChipIsNamed) {
  const TriggerProgram program = two_cameras_two_projectors();
  GpioTriggerConfig config;
  for (const TriggerLine& line : program.lines) {
    config.outputs.push_back({.name = line.name, .chip = "facet-no-such-chip", .line = "3"});
  }
  EXPECT_THAT(complaint(program, config, ErrorKind::Unavailable),
              ::testing::AllOf(HasSubstr("GPIO chip 'facet-no-such-chip'"), HasSubstr("this machine shows")));
}

}  // namespace
}  // namespace facet::trigger
