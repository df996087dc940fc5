#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "trigger/gpio_trigger.hpp"

// What Facet needs of libgpiod. A file gpio_library_v<N>.cpp says it to each of its major versions, and
// decides nothing.

namespace facet::trigger {

/// What a chip knows of one of its lines.
struct GpioLineInfo {
  std::string name;  ///< empty where it has none
  bool used = false;
  std::string holder;  ///< by whom it is used; empty where the chip can't tell
};

/// A line to be driven.
struct GpioWire {
  unsigned offset = 0;
  LineDrive drive = LineDrive::PushPull;
  bool high = false;  ///< at first
};

/// What an input saw.
struct GpioEdge {
  bool high = false;         ///< after it
  std::int64_t time_ns = 0;  ///< CLOCK_MONOTONIC
};

/// Sets lines that are driven together; real-time safe. levels: [lines requested] 0 or 1, in the request's
/// order. False, and errno, where it failed. Empty where the request was refused. Gone before its chip is.
using GpioOutputs = std::function<bool(std::span<const int> levels)>;

/// Edges of an input since the last call, oldest first, as many as fit into `out`; real-time safe, never
/// waits. Empty where the request was refused. Gone before its chip is.
using GpioInput = std::function<std::size_t(std::span<GpioEdge> out)>;

class GpioChip {
 public:
  GpioChip() = default;
  GpioChip(const GpioChip&) = delete;
  GpioChip& operator=(const GpioChip&) = delete;
  virtual ~GpioChip() = default;

  virtual std::string title() const = 0;  ///< "NAME [LABEL]"
  virtual unsigned line_count() const = 0;
  virtual std::optional<unsigned> offset_of(const std::string& line_name) const = 0;
  /// As it is now; none where the chip has no such line.
  virtual std::optional<GpioLineInfo> line(unsigned offset) const = 0;

  /// Empty, and errno, where it was refused. Lines of several drives only where GpioLibrary::mixes_drives.
  virtual GpioOutputs drive(const std::string& consumer, std::span<const GpioWire> wires) = 0;
  /// Empty, and errno, where it was refused.
  virtual GpioInput watch(const std::string& consumer, unsigned offset) = 0;
};

struct GpioLibrary {
  /// By name, label, number or device path; null, and errno, where there is none.
  std::function<std::unique_ptr<GpioChip>(const std::string& wanted)> open;
  std::function<std::vector<std::string>()> chip_titles;  ///< of this machine
  bool mixes_drives = false;                              ///< lines of several drives can be set by one call
};

/// libgpiod of this machine.
const GpioLibrary& system_gpio_library();

}  // namespace facet::trigger
