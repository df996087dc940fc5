#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace facet::files {

/// A picture's numbers as they are coded, R G B interleaved, top row first. Value: std::uint8_t or
/// std::uint16_t, each over its whole range.
template <typename Value>
struct RgbImage {
  int width_px = 0;
  int height_px = 0;
  std::vector<Value> values;  ///< [height_px][width_px][3]
};

/// What a reader takes at most: larger pictures are refused before memory is taken for them.
inline constexpr int kMostImageSide_px = 32768;
inline constexpr std::size_t kMostImagePixels = 100'000'000;

/// The picture in the bytes of a PNG or JPEG file. Grey and palettes become R G B, transparency is dropped, 8
/// bits become 16 by v * 257 and 16 bits 8 by rounding. A JPEG comes out upright, as its camera says that it
/// was held. A picture that is cut short or damaged is refused.
/// source       names the bytes in messages
/// most_pixels  of the picture
/// Throws Error(UnreadableInput). Any thread.
template <typename Value>
RgbImage<Value> parse_image(std::span<const std::byte> bytes, const std::string& source,
                            std::size_t most_pixels = kMostImagePixels);
extern template RgbImage<std::uint8_t> parse_image(std::span<const std::byte>, const std::string&,
                                                   std::size_t);
extern template RgbImage<std::uint16_t> parse_image(std::span<const std::byte>, const std::string&,
                                                    std::size_t);

/// The same of a file of at most 1 GB. Throws Error(UnreadableInput) naming it.
template <typename Value>
RgbImage<Value> read_image(const std::filesystem::path& file);
extern template RgbImage<std::uint8_t> read_image(const std::filesystem::path&);
extern template RgbImage<std::uint16_t> read_image(const std::filesystem::path&);

/// A PNG file's bytes, of 8 or 16 bits a channel, packed for speed.
/// values  [height_px][width_px][channels], channels 1 (grey) or 3 (R G B)
/// Throws Error(Internal) where the sizes do not agree.
std::vector<std::uint8_t> encode_png(int width_px, int height_px, std::span<const std::uint8_t> values);
std::vector<std::uint8_t> encode_png(int width_px, int height_px, std::span<const std::uint16_t> values);

/// A JPEG file's bytes, baseline, colours at half the resolution: for pictures of cameras, which are
/// compressed by many as they come.
/// values   [height_px][width_px][channels], channels 1 (grey) or 3 (R G B)
/// quality  1 to 100
/// Throws Error(Internal) where the sizes do not agree.
std::vector<std::uint8_t> encode_jpeg(int width_px, int height_px, std::span<const std::uint8_t> values,
                                      int quality);

}  // namespace facet::files
