#pragma once

#include <cerrno>
#include <cstring>
#include <memory>
#include <string>

#include "trigger/gpio_trigger.hpp"
#include "trigger/lines.hpp"

namespace facet::trigger {

/// The lines of a program behind libgpiod; a file gpio_lines_v<N>.cpp for each of its major versions.
/// `program` and `config` fit together. Throws Error(Unavailable).
std::unique_ptr<TriggerLines> open_gpio_lines(const TriggerProgram& program, const GpioTriggerConfig& config);

/// Why a chip can't be opened, and what to do where rights are missing.
inline std::string chip_fault(int error) {
  std::string text = std::strerror(error);
  if (error == EACCES || error == EPERM) {
    text += " (its device is for a group, facet-gpio where the package is installed: sudo -u facet)";
  }
  return text;
}

}  // namespace facet::trigger
