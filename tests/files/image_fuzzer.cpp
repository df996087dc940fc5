// A picture of any bytes is read or refused, nothing else, and no larger than asked for.

#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "facet/error.hpp"
#include "files/image_file.hpp"

namespace {

constexpr std::size_t kMostPixels = 65536;

template <typename Value>
void try_to_read(std::span<const std::byte> bytes) {
  try {
    const auto image = facet::files::parse_image<Value>(bytes, "fuzzed", kMostPixels);
    const auto pixels = static_cast<std::size_t>(image.width_px) * static_cast<std::size_t>(image.height_px);
    if (pixels > kMostPixels || image.values.size() != 3 * pixels) {
      std::abort();
    }
  } catch (const facet::Error&) {
    return;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto bytes = std::as_bytes(std::span(data, size));
  try_to_read<std::uint8_t>(bytes);
  try_to_read<std::uint16_t>(bytes);
  return 0;
}
