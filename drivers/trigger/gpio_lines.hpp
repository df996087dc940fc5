#pragma once

#include <memory>

#include "trigger/gpio_trigger.hpp"
#include "trigger/lines.hpp"

namespace facet::trigger {

/// The lines of a program behind libgpiod; a file gpio_lines_v<N>.cpp for each of its major versions.
/// `program` and `config` fit together. Throws Error(Unavailable).
std::unique_ptr<TriggerLines> open_gpio_lines(const TriggerProgram& program, const GpioTriggerConfig& config);

}  // namespace facet::trigger
