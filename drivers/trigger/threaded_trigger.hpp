#pragma once

#include <memory>

#include "facet/trigger.hpp"
#include "trigger/lines.hpp"

namespace facet::trigger {

struct ThreadOptions {
  /// SCHED_FIFO and locked memory for the edge thread. Without the right to them it runs all the same, and
  /// the status says what is missing.
  bool real_time = true;
  int priority = 50;  ///< of SCHED_FIFO, 1 to 99; interrupt threads have 50
};

/// A Trigger whose program runs on the thread `facet-trigger`: started by start, joined by stop, blocked only
/// in clock_nanosleep. Its events go through a ring of 4096; what does not fit is counted as lost. The lines
/// are driven by this object alone from here on.
/// Throws Error(Usage) for a program that can't be run.
std::unique_ptr<Trigger> make_threaded_trigger(const TriggerProgram& program,
                                               std::unique_ptr<TriggerLines> lines,
                                               const ThreadOptions& options);

}  // namespace facet::trigger
