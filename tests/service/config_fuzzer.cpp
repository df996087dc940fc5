#include <cstddef>
#include <cstdint>
#include <string_view>

#include "facet/error.hpp"
#include "service/config.hpp"

/// Any text is a configuration or an Error of kind Usage.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size > facet::service::kMaxConfigBytes) {
    return 0;
  }
  try {
    facet::service::parse_config({reinterpret_cast<const char*>(data), size}, "fuzz.toml");
  } catch (const facet::Error& error) {
    if (error.kind() != facet::ErrorKind::Usage) {
      __builtin_trap();
    }
  }
  return 0;
}
