#pragma once

#include <cstdint>
#include <functional>
#include <memory>

#include "facet/trigger.hpp"
#include "trigger/threaded_trigger.hpp"

namespace facet::trigger {

struct VirtualTriggerOptions {
  ThreadOptions thread{.real_time = false};
  LineMask read_back = 0;  ///< lines whose edges are read back
  /// What hangs on the lines: told of every change with the lines that are active now. On the edge thread;
  /// must be quick and must not throw.
  std::function<void(LineMask active, std::int64_t time_ns)> on_change;
};

/// A trigger without wires, for simulated cameras and projectors: the same program runner, times and states
/// as open_gpio_trigger. Throws Error(Usage) for a program that can't be run.
std::unique_ptr<Trigger> make_virtual_trigger(const TriggerProgram& program, VirtualTriggerOptions options);

}  // namespace facet::trigger
