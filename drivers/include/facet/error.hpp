#pragma once

#include <stdexcept>
#include <string>

namespace facet {

/// What went wrong at start-up or in a command, as a user can act on it. Command-line programs exit with the
/// value.
enum class ErrorKind : int {
  Internal = 1,         ///< a fault of ours
  Usage = 2,            ///< wrong arguments or configuration
  UnreadableInput = 3,  ///< a file, device or message that can't be read as what it should be
  NoFace = 4,           ///< no face in the whole input
  NoDevice = 5,         ///< no usable Vulkan device
  Storage = 6,          ///< cannot write: disk full, no permission, path taken
  Unavailable = 7,      ///< what does not answer, or is short now: another try may help
};

/// Thrown at start-up and by command-line tools; never on the per-frame path. The message names the file,
/// line, key or device and says what to do.
class Error : public std::runtime_error {
 public:
  Error(ErrorKind kind, const std::string& message) : std::runtime_error(message), kind_(kind) {}
  ErrorKind kind() const { return kind_; }

 private:
  ErrorKind kind_;
};

}  // namespace facet
