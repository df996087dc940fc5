#include <cstddef>
#include <cstdint>
#include <string_view>

#include "capture/code_sequence.hpp"
#include "facet/error.hpp"

/// Any text is a sequence whose pictures have names, or an Error of kind Usage; what can be drawn is.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  namespace capture = facet::capture;
  if (size > 4096) {
    return 0;
  }
  try {
    const capture::CodeSequence sequence =
        capture::parse_sequence({reinterpret_cast<const char*>(data), size});
    capture::PatternConfig config;
    config.width_px = 32;
    config.height_px = 16;
    for (std::size_t picture = 0; picture < sequence.pictures.size(); ++picture) {
      if (capture::name_of(sequence, picture).empty()) {
        __builtin_trap();
      }
    }
    if (capture::draw_coded(config, sequence, sequence.pictures.size() - 1).values.size() != 32 * 16) {
      __builtin_trap();
    }
  } catch (const facet::Error& error) {
    if (error.kind() != facet::ErrorKind::Usage) {
      __builtin_trap();
    }
  }
  return 0;
}
