#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "facet/frame.hpp"

/// Pictures without padding and alpha, as messages and takes hold them: R G B, or one channel where all three
/// are the same. Any thread.
namespace facet::stream {

/// 1 where red, green and blue are the same in every pixel, else 3. Most colour pictures are known by their
/// first row.
std::size_t channel_count(const Frame& frame);

/// out [height_px][width_px][channels]; channels as channel_count says, or 3
void pack_pixels(const Frame& frame, std::size_t channels, std::uint8_t* out);

/// The picture smaller by a whole number each way, each pixel the mean of those that it stands for; what is
/// left over at the right and below is left out.
/// scale  1 to 255, at most the shorter side
/// out    [height_px / scale][width_px / scale][3] R G B
void pack_smaller(const Frame& frame, int scale, std::uint8_t* out);

/// A new picture's pixels. packed [pixel_count][channels]; returns [pixel_count][4] R G B A, A = 255
std::shared_ptr<const std::uint8_t[]> unpack_pixels(const std::uint8_t* packed, std::size_t channels,
                                                    std::size_t pixel_count);

}  // namespace facet::stream
