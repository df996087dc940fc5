#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace facet::files {

/// One number a pixel, top row first.
struct FloatImage {
  int width_px = 0;
  int height_px = 0;
  std::vector<float> values;  ///< [height_px][width_px]
};

/// Writes a grey portable float map ("Pf", little-endian, bottom row first as the format wants it), whole or
/// not at all. Throws Error(Storage), and Error(Internal) where sizes and values don't agree.
void write_pfm(const FloatImage& image, const std::filesystem::path& file);

/// Reads what write_pfm writes, from any program. Throws Error(UnreadableInput) naming the file and what is
/// wrong: missing, coloured, big-endian, cut off, sides over 32768 px; Error(Usage) beyond 1 GiB.
FloatImage read_pfm(const std::filesystem::path& file);

/// The same from memory; source names it in messages.
FloatImage parse_pfm(std::span<const std::byte> bytes, const std::string& source);

}  // namespace facet::files
