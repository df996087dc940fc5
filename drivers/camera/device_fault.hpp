#pragma once

#include <stdexcept>
#include <string>

namespace facet::camera {

/// Why a device can't be used now. Who catches it puts the device's name before the message.
struct DeviceFault : std::runtime_error {
  enum class Kind {
    Absent,      ///< no such device, or it went away
    Failing,     ///< it is there and refuses
    Unsuitable,  ///< it can't do what the configuration asks; the message says what it can
  };
  DeviceFault(Kind given, const std::string& message) : std::runtime_error(message), kind(given) {}
  Kind kind;
};

}  // namespace facet::camera
