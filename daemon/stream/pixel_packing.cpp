#include "stream/pixel_packing.hpp"

#include <array>
#include <bit>
#include <cstring>

namespace facet::stream {
namespace {

constexpr std::size_t kRgbaBytes = 4;

// R is the lowest byte of a pixel that is read as one word.
static_assert(std::endian::native == std::endian::little);

std::uint32_t pixel(const std::uint8_t* rgba) {
  std::uint32_t value = 0;
  std::memcpy(&value, rgba, sizeof(value));
  return value;
}

template <std::size_t Channels>
void pack_row(const std::uint8_t* rgba, std::size_t width, std::uint8_t* out) {
  for (std::size_t x = 0; x < width; ++x) {
    for (std::size_t channel = 0; channel < Channels; ++channel) {
      out[x * Channels + channel] = rgba[x * kRgbaBytes + channel];
    }
  }
}

template <std::size_t Channels>
void unpack(const std::uint8_t* packed, std::size_t count, std::uint8_t* rgba) {
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t channel = 0; channel < 3; ++channel) {
      rgba[i * kRgbaBytes + channel] = packed[i * Channels + (Channels == 1 ? 0 : channel)];
    }
    rgba[i * kRgbaBytes + 3] = 255;
  }
}

}  // namespace

std::size_t channel_count(const Frame& frame) {
  const auto width = static_cast<std::size_t>(frame.width_px);
  for (int y = 0; y < frame.height_px; ++y) {
    const std::uint8_t* row = frame.row(y);
    std::uint32_t difference = 0;
    for (std::size_t x = 0; x < width; ++x) {
      const std::uint32_t rgba = pixel(row + x * kRgbaBytes);
      difference |= rgba ^ (rgba >> 8U);
    }
    if ((difference & 0xFFFFU) != 0) {
      return 3;
    }
  }
  return 1;
}

void pack_pixels(const Frame& frame, std::size_t channels, std::uint8_t* out) {
  const auto width = static_cast<std::size_t>(frame.width_px);
  for (int y = 0; y < frame.height_px; ++y) {
    channels == 1 ? pack_row<1>(frame.row(y), width, out) : pack_row<3>(frame.row(y), width, out);
    out += width * channels;
  }
}

void pack_smaller(const Frame& frame, int scale, std::uint8_t* out) {
  const auto step = static_cast<std::size_t>(scale);
  const auto count = static_cast<std::uint32_t>(step * step);
  const std::size_t width = static_cast<std::size_t>(frame.width_px) / step;
  for (int y = 0; y + scale <= frame.height_px; y += scale) {
    for (std::size_t x = 0; x < width; ++x) {
      std::array<std::uint32_t, 3> sum{};
      for (int row = y; row < y + scale; ++row) {
        const std::uint8_t* rgba = frame.row(row) + x * step * kRgbaBytes;
        for (std::size_t k = 0; k < step * kRgbaBytes; k += kRgbaBytes) {
          sum[0] += rgba[k];
          sum[1] += rgba[k + 1];
          sum[2] += rgba[k + 2];
        }
      }
      for (const std::uint32_t total : sum) {
        *out++ = static_cast<std::uint8_t>((total + count / 2) / count);
      }
    }
  }
}

std::shared_ptr<const std::uint8_t[]> unpack_pixels(const std::uint8_t* packed, std::size_t channels,
                                                    std::size_t pixel_count) {
  auto rgba = std::make_shared_for_overwrite<std::uint8_t[]>(pixel_count * kRgbaBytes);
  channels == 1 ? unpack<1>(packed, pixel_count, rgba.get()) : unpack<3>(packed, pixel_count, rgba.get());
  return rgba;
}

}  // namespace facet::stream
