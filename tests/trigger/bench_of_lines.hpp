#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "trigger/lines.hpp"
#include "trigger/program.hpp"
#include "trigger/runner.hpp"

namespace facet::trigger {

constexpr std::int64_t kMicrosecond = 1'000;
constexpr std::int64_t kMillisecond = 1'000'000;

/// Two cameras (a short pulse, the whole exposure, active low) and two projectors, one of which rests active;
/// pattern A, pattern B, blank. 100 slots a second, settle 1 ms, exposure 5 ms.
inline TriggerProgram two_cameras_two_projectors() {
  TriggerProgram program;
  program.lines = {{.name = "camera.left", .pulse_ns = kMillisecond},
                   {.name = "camera.right", .active_low = true},
                   {.name = "projector.a", .role = LineRole::Projector},
                   {.name = "projector.b", .role = LineRole::Projector, .safe_active = true}};
  program.patterns = {0b0100, 0b1000, 0b0000};
  program.slots_per_second = 100;
  program.settle_ns = kMillisecond;
  program.exposure_ns = 5 * kMillisecond;
  return program;
}

/// Lines, clock and event sink whose time passes only where the test says so: a sleep ends on time, setting
/// lines takes 3 us, and now and then the machine stalls. Keeps what happened.
class BenchOfLines final : public TriggerLines, public TriggerClock, public TriggerEventSink {
 public:
  struct Change {
    std::int64_t time_ns = 0;
    LineMask level = 0;
  };

  explicit BenchOfLines(const TriggerProgram& program) : level(safe_lines(program)) {}

  bool set(LineMask which, LineMask active) override {
    time_ns += 3 * kMicrosecond;
    if (broken_from_ns > 0 && time_ns >= broken_from_ns) {
      return false;
    }
    const LineMask changed = which & (level ^ active);
    level ^= changed;
    changes.push_back({time_ns, level});
    for (std::uint8_t line = 0; line < kMaxTriggerLines; ++line) {
      if ((changed & proven_lines & LineMask{1} << line) != 0 && !unproven(line, time_ns)) {
        seen_edges.push_back({line, (level >> line & 1) != 0, time_ns + 40 * kMicrosecond});
      }
    }
    return true;
  }
  LineMask read_back() const override { return proven_lines; }
  std::size_t seen(std::span<SeenEdge> out) override {
    std::size_t count = 0;
    while (count < out.size() && !seen_edges.empty() && seen_edges.front().time_ns <= time_ns) {
      out[count++] = seen_edges.front();
      seen_edges.erase(seen_edges.begin());
    }
    return count;
  }
  std::string last_error() const override { return "cut"; }

  std::int64_t now_ns() override { return time_ns; }
  void sleep_until(std::int64_t deadline_ns) override {
    time_ns = std::max(time_ns, deadline_ns);
    const auto due = [&](const auto& stall) { return stall.first <= time_ns; };
    for (auto stall = std::find_if(stalls.begin(), stalls.end(), due); stall != stalls.end();
         stall = std::find_if(stalls.begin(), stalls.end(), due)) {
      time_ns = std::max(time_ns, stall->first + stall->second);
      stalls.erase(stall);
    }
  }

  void put(const TriggerEvent& event) override {
    events.push_back(event);
    if (event.kind == TriggerEvent::Kind::Fired && ++fired == stop_after) {
      stop = true;
    }
  }

  /// Runs until so many slots have fired.
  bool run(const TriggerProgram& program, std::uint64_t slots, std::uint64_t first_slot = 0) {
    stop = false;
    fired = 0;
    stop_after = slots;
    TriggerRunner runner(program, *this, *this, *this, counters);
    return runner.run(first_slot, stop);
  }

  std::vector<TriggerEvent> events_of(TriggerEvent::Kind kind) const {
    std::vector<TriggerEvent> found;
    std::copy_if(events.begin(), events.end(), std::back_inserter(found),
                 [kind](const TriggerEvent& event) { return event.kind == kind; });
    return found;
  }

  std::int64_t time_ns = 1'000'000'000;
  std::vector<std::pair<std::int64_t, std::int64_t>> stalls;  ///< from when, for how long
  std::int64_t broken_from_ns = 0;                            ///< 0: never
  LineMask proven_lines = 0;
  std::function<bool(std::uint8_t line, std::int64_t time_ns)> unproven = [](auto, auto) { return false; };
  std::vector<SeenEdge> seen_edges;
  LineMask level;
  std::vector<Change> changes;
  std::vector<TriggerEvent> events;
  RunCounters counters;
  std::atomic<bool> stop = false;
  std::uint64_t fired = 0;
  std::uint64_t stop_after = 0;
};

}  // namespace facet::trigger
