// A portable float map of any bytes is read or refused, nothing else.

#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "facet/error.hpp"
#include "files/pfm.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const auto image = facet::files::parse_pfm(std::as_bytes(std::span(data, size)), "fuzzed");
    if (image.values.size() !=
        static_cast<std::size_t>(image.width_px) * static_cast<std::size_t>(image.height_px)) {
      std::abort();
    }
  } catch (const facet::Error&) {
    return 0;
  }
  return 0;
}
