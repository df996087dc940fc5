#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace facet {

/// One bit per line of a trigger program, in the order of TriggerProgram::lines.
using LineMask = std::uint64_t;
inline constexpr std::size_t kMaxTriggerLines = 64;

enum class LineRole : std::uint8_t {
  Camera,     ///< active while its camera exposes (or for a short pulse at the start of exposure)
  Projector,  ///< active while its pattern is shown
};

struct TriggerLine {
  std::string name;  ///< unique, for events and wiring: "camera.left"
  LineRole role = LineRole::Camera;
  bool active_low = false;  ///< the wire is low while the line is active
  /// The level before the first slot, between exposures and after the end; cameras rest inactive.
  bool safe_active = false;
  std::int64_t pulse_ns = 0;  ///< camera: how long the line stays active; 0: the whole exposure
};

/// What every slot does. Slot n begins at n / slots_per_second after the start: projector lines are set,
/// after settle_ns all camera lines become active together, cameras whose pulse is over are released, and
/// exposure_ns after the firing the rest goes back to its safe level.
struct TriggerProgram {
  std::vector<TriggerLine> lines;
  /// Projector lines that are active in slot n: patterns[n % patterns.size()]; 0 is a blank slot.
  std::vector<LineMask> patterns;
  double slots_per_second = 60;         ///< 1 to 1000
  std::int64_t settle_ns = 0;           ///< from the pattern to the firing
  std::int64_t exposure_ns = 0;         ///< from the firing to the release
  std::int64_t tolerance_ns = 500'000;  ///< a slot that can't start or fire within this is dropped whole
};

/// Something that happened on the trigger's lines. Times are CLOCK_MONOTONIC.
struct TriggerEvent {
  enum class Kind : std::uint8_t {
    Edge,     ///< a line was set
    Seen,     ///< `line` was set at planned_ns, and its read-back line changed at actual_ns
    Missing,  ///< `line` was set at planned_ns, and its read-back line did not change
    Dropped,  ///< slots [slot, slot + slot_count) were left out whole; their numbers do not come again
    Fired,    ///< all camera lines of the slot became active at actual_ns
  };
  Kind kind = Kind::Edge;
  std::uint8_t line = 0;  ///< Edge, Seen, Missing: index into TriggerProgram::lines
  bool active = false;    ///< Edge, Seen, Missing: what the line became
  bool late = false;      ///< Edge: more than TriggerProgram::tolerance_ns after planned_ns
  std::uint64_t slot = 0;
  std::uint64_t slot_count = 1;  ///< Dropped
  std::int64_t planned_ns = 0;
  std::int64_t actual_ns = 0;  ///< Edge, Fired: when the call that set the line had returned
  std::int64_t call_ns = 0;    ///< Edge, Fired: how long the call took; the edge lies within it
};

enum class TriggerState {
  Idle,     ///< not started, or stopped; lines at their safe level
  Running,  ///< slots are fired
  Failing,  ///< the lines can't be set any more; TriggerStatus::reason says why
};

constexpr const char* to_string(TriggerState state) {
  constexpr std::array kNames = {"idle", "running", "failing"};
  return kNames.at(static_cast<std::size_t>(state));
}

struct TriggerStatus {
  TriggerState state = TriggerState::Idle;
  std::string reason;      ///< of Failing
  bool real_time = false;  ///< SCHED_FIFO and locked memory, both
  std::string scheduling;  ///< for people: what the edge thread got, and what right is missing
  std::uint64_t slots_fired = 0;
  std::uint64_t slots_dropped = 0;
  std::uint64_t edges = 0;
  std::uint64_t edges_late = 0;
  std::int64_t worst_late_ns = 0;
  std::uint64_t edges_proven = 0;   ///< seen by their read-back line
  std::uint64_t edges_missing = 0;  ///< not seen by it
  std::uint64_t edges_stray = 0;    ///< seen, and nobody had set them
  std::uint64_t events_lost = 0;    ///< nobody took them in time
};

/// Runs a TriggerProgram. Life: open (a factory in drivers/trigger, may throw Error) -> start -> next ... ->
/// request_stop -> stop -> destroy. The lines are at their safe level whenever no slot runs.
class Trigger {
 public:
  Trigger() = default;
  Trigger(const Trigger&) = delete;
  Trigger& operator=(const Trigger&) = delete;
  virtual ~Trigger() = default;

  virtual const TriggerProgram& program() const = 0;

  /// Begins with slot `first_slot`, shortly after the call. Not while running. A start after a failure passes
  /// a number that was not used before.
  virtual void start(std::uint64_t first_slot) = 0;

  /// Waits for the next event, `timeout` at most; false where there was none. One thread.
  virtual bool next(TriggerEvent& out, std::chrono::milliseconds timeout) = 0;

  /// First phase of stopping: the slot that runs is finished, no other begins. Any thread; returns at once.
  virtual void request_stop() = 0;
  /// Second phase: waits until the lines are at their safe level, one slot at most. Idempotent.
  virtual void stop() = 0;

  virtual TriggerStatus status() const = 0;  ///< any thread
};

}  // namespace facet
