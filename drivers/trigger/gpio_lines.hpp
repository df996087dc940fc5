#pragma once

#include <memory>

#include "trigger/gpio_library.hpp"
#include "trigger/gpio_trigger.hpp"
#include "trigger/lines.hpp"

namespace facet::trigger {

/// The lines of a program on GPIO chips. `program` and `config` fit together; the library outlives the lines.
/// Throws Error(Unavailable).
std::unique_ptr<TriggerLines> open_gpio_lines(const TriggerProgram& program, const GpioTriggerConfig& config,
                                              const GpioLibrary& library = system_gpio_library());

}  // namespace facet::trigger
