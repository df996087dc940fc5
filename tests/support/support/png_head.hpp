#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>

namespace facet::test {

/// What the first chunk of a PNG file says of its pixels.
struct PngHead {
  int width_px = 0;
  int height_px = 0;
  int bits = 0;         ///< a channel
  bool colour = false;  ///< R G B; else grey. 0 bits where it is something else
  bool operator==(const PngHead&) const = default;
};

/// All 0 where there is no such file.
inline PngHead png_head_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::uint8_t head[26] = {};
  if (!stream.read(reinterpret_cast<char*>(head), sizeof head)) {
    return {};
  }
  const auto number = [&](int at) {
    return head[at] << 24 | head[at + 1] << 16 | head[at + 2] << 8 | head[at + 3];
  };
  const int kind = head[25];
  return {number(16), number(20), kind == 0 || kind == 2 ? head[24] : 0, kind == 2};
}

}  // namespace facet::test
