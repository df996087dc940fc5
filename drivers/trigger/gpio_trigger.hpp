#pragma once

#include <memory>
#include <string>
#include <vector>

#include "facet/trigger.hpp"
#include "trigger/threaded_trigger.hpp"

namespace facet::trigger {

enum class LineDrive {
  PushPull,
  OpenDrain,   ///< drives low, lets go for high: needs a pull-up
  OpenSource,  ///< drives high, lets go for low: needs a pull-down
};

/// Where a line of the program leaves the computer. `chip` is a GPIO chip's name, label, number or device
/// path; `line` its line's name, or its offset in digits.
struct GpioOutput {
  std::string name;  ///< of the program's line
  std::string chip;
  std::string line;
  LineDrive drive = LineDrive::PushPull;
};

/// An input that is wired to a line of the program, behind driver and cable, and proves its edges.
struct GpioReadBack {
  std::string name;  ///< of the program's line that it proves
  std::string chip;
  std::string line;
  bool active_low = false;  ///< the input is low while the program's line is active
};

struct GpioTriggerConfig {
  std::vector<GpioOutput> outputs;  ///< one for every line of the program
  std::vector<GpioReadBack> read_backs;
  std::string consumer = "facet";  ///< what others see as the holder of the lines
  ThreadOptions thread;
};

/// Takes the lines, puts them to their safe level and makes a trigger of them. Throws Error(Usage) where
/// program and wiring do not fit together, Error(Unavailable) where a chip is missing or a line can't be had;
/// the message names chip, line, and who holds it.
///
/// Destroying the trigger puts the lines to their safe level and gives them back. After a crash the kernel
/// gives them back as they are (docs/wiring.md).
std::unique_ptr<Trigger> open_gpio_trigger(const TriggerProgram& program, const GpioTriggerConfig& config);

}  // namespace facet::trigger
