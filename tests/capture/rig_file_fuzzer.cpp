#include <cstddef>
#include <cstdint>
#include <string_view>

#include "capture/rig_file.hpp"
#include "facet/error.hpp"

/// Any text is a rig, which reads back from what is written of it, or an Error of kind Usage.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  namespace capture = facet::capture;
  if (size > capture::kMaxRigFileBytes) {
    return 0;
  }
  capture::Rig rig;
  try {
    rig = capture::parse_rig({reinterpret_cast<const char*>(data), size}, "fuzz.toml");
  } catch (const facet::Error& error) {
    if (error.kind() != facet::ErrorKind::Usage) {
      __builtin_trap();
    }
    return 0;
  }
  const std::string text = capture::format_rig(rig);
  if (capture::format_rig(capture::parse_rig(text, "again.toml")) != text) {
    __builtin_trap();
  }
  return 0;
}
