#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "facet/trigger.hpp"

namespace facet::trigger {

/// An edge that a read-back line saw.
struct SeenEdge {
  std::uint8_t line = 0;  ///< the program's line that it proves
  bool active = false;
  std::int64_t time_ns = 0;  ///< CLOCK_MONOTONIC
};

/// The output lines of one program. Opened at their safe level; the destructor brings them back to it. The
/// thread that runs the program calls set and seen; both are real-time safe.
class TriggerLines {
 public:
  TriggerLines() = default;
  TriggerLines(const TriggerLines&) = delete;
  TriggerLines& operator=(const TriggerLines&) = delete;
  virtual ~TriggerLines() = default;

  /// Makes the lines of `which` active where `active` has their bit, else inactive; those of one chip change
  /// at once. Polarity is dealt with here. False where it failed.
  virtual bool set(LineMask which, LineMask active) = 0;

  /// Lines whose edges are read back.
  virtual LineMask read_back() const = 0;
  /// Edges seen since the last call, oldest first of every line; as many as fit into `out`. Never waits.
  virtual std::size_t seen(std::span<SeenEdge> out) = 0;

  /// Why set failed, naming line and chip. Not real-time safe.
  virtual std::string last_error() const = 0;
};

/// The time of the thread that runs a program.
class TriggerClock {
 public:
  TriggerClock() = default;
  TriggerClock(const TriggerClock&) = delete;
  TriggerClock& operator=(const TriggerClock&) = delete;
  virtual ~TriggerClock() = default;

  virtual std::int64_t now_ns() = 0;                       ///< CLOCK_MONOTONIC
  virtual void sleep_until(std::int64_t deadline_ns) = 0;  ///< returns at the deadline or later
};

/// Where a runner's events go; real-time safe.
class TriggerEventSink {
 public:
  TriggerEventSink() = default;
  TriggerEventSink(const TriggerEventSink&) = delete;
  TriggerEventSink& operator=(const TriggerEventSink&) = delete;
  virtual ~TriggerEventSink() = default;

  virtual void put(const TriggerEvent& event) = 0;
};

}  // namespace facet::trigger
