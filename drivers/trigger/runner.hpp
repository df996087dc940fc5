#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

#include "facet/trigger.hpp"
#include "trigger/lines.hpp"

namespace facet::trigger {

/// Counters of a run; written by the runner, read by any thread.
struct RunCounters {
  std::atomic<std::uint64_t> slots_fired = 0;
  std::atomic<std::uint64_t> slots_dropped = 0;
  std::atomic<std::uint64_t> edges = 0;
  std::atomic<std::uint64_t> edges_late = 0;
  std::atomic<std::int64_t> worst_late_ns = 0;
  std::atomic<std::uint64_t> edges_proven = 0;
  std::atomic<std::uint64_t> edges_missing = 0;
  std::atomic<std::uint64_t> edges_stray = 0;
};

/// Plans the edges of a program and sets them in time, on the thread that calls run. Every deadline is
/// absolute, so that lateness never adds up; a settle time or pulse that began late still has its full
/// length. A slot is fired whole or dropped whole: where its start, or after a stall its firing, would come
/// later than the program's tolerance, no camera line moves and its number is left out.
class TriggerRunner {
 public:
  /// Throws Error(Usage) for a program that can't be run. All but the program is borrowed.
  TriggerRunner(const TriggerProgram& program, TriggerLines& lines, TriggerClock& clock,
                TriggerEventSink& events, RunCounters& counters);

  /// Runs slots from `first_slot` on until `stop` is set, then brings the lines to their safe level. False
  /// where the lines failed. Allocates nothing and, between slots, looks at `stop` every 20 ms.
  bool run(std::uint64_t first_slot, const std::atomic<bool>& stop);

 private:
  enum class SlotEnd { Done, LinesFailed };
  /// A change of lines at a time after the firing.
  struct Release {
    std::int64_t after_fire_ns = 0;
    LineMask which = 0;
  };
  /// An edge that a read-back line has yet to show.
  struct Awaited {
    std::uint8_t line = 0;
    bool active = false;
    std::uint64_t slot = 0;
    std::int64_t from_ns = 0;  ///< it can't be seen before
  };
  struct Change {
    bool done = false;
    std::int64_t actual_ns = 0;
    std::int64_t call_ns = 0;
  };

  std::int64_t start_ns(std::uint64_t slots_after_first) const;
  bool wait_for_start(std::int64_t deadline_ns, const std::atomic<bool>& stop);
  SlotEnd run_slot(std::uint64_t slot, std::int64_t planned_ns);
  Change change(std::uint64_t slot, LineMask which, LineMask active, std::int64_t planned_ns);
  void drop(std::uint64_t slot, std::uint64_t slot_count, std::int64_t planned_ns);
  void await(std::uint64_t slot, std::size_t line, bool active, std::int64_t from_ns);
  void collect_seen();
  void report_missing(std::uint64_t before_slot);

  TriggerProgram program_;
  TriggerLines& lines_;
  TriggerClock& clock_;
  TriggerEventSink& events_;
  RunCounters& counters_;
  LineMask cameras_;
  LineMask projectors_;
  LineMask safe_;
  LineMask level_;  ///< as last set
  std::vector<Release> releases_;
  std::int64_t origin_ns_ = 0;
  std::array<Awaited, 4 * kMaxTriggerLines> awaited_{};  ///< two slots of two edges a line, oldest first
  std::size_t awaited_count_ = 0;
};

}  // namespace facet::trigger
