// Any text is an edge log, which then is the same when written and read again, or refused.

#include <cstddef>
#include <cstdint>
#include <string_view>

#include "facet/error.hpp"
#include "trigger/edge_log.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet::trigger;
  try {
    const std::string text = to_text(parse_edge_log({reinterpret_cast<const char*>(data), size}, "fuzzed"));
    if (to_text(parse_edge_log(text, "written")) != text) {
      __builtin_trap();
    }
  } catch (const facet::Error& error) {
    if (error.kind() != facet::ErrorKind::UnreadableInput ||
        std::string_view(error.what()).starts_with("written")) {
      __builtin_trap();
    }
  }
  return 0;
}
