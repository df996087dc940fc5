#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "facet/frame.hpp"

namespace facet::hil {

/// A number painted into a picture, at its top and at its bottom: what a frame is follows from its pixels
/// alone. 32 cells of 8 x 8 pixels in a row, the lowest bit first, bright is 1. Bits 0 to 23 count pictures,
/// bits 24 to 31 hold the pattern that was shown.
inline constexpr int kCells = 32;
inline constexpr int kCell_px = 8;
inline constexpr int kLeastWidth_px = kCells * kCell_px;
inline constexpr std::uint32_t kPictureMask = 0xFFFFFF;

struct PaintedNumber {
  std::uint32_t picture = 0;  ///< modulo 2^24
  std::uint32_t pattern = 0;  ///< 0 to 255

  bool operator==(const PaintedNumber&) const = default;
};

/// Paints into YUYV. pixels: [height_px][width_px][2], width_px at least kLeastWidth_px.
inline void paint(std::span<std::uint8_t> pixels, int width_px, int height_px, const PaintedNumber& number) {
  const std::uint32_t bits = (number.picture & kPictureMask) | number.pattern << 24;
  for (int row = 0; row < 2 * kCell_px; ++row) {
    const int y = row < kCell_px ? row : height_px - 2 * kCell_px + row;
    for (int x = 0; x < kLeastWidth_px; ++x) {
      const bool one = (bits >> (x / kCell_px) & 1) != 0;
      const auto at =
          (static_cast<std::size_t>(y) * static_cast<std::size_t>(width_px) + static_cast<std::size_t>(x)) *
          2;
      pixels[at] = one ? 235 : 16;
      pixels[at + 1] = 128;
    }
  }
}

/// The number in the row of cells around y; none where there is no such row of black and white cells.
inline std::optional<PaintedNumber> read_cells(const Frame& frame, int y) {
  constexpr int kBlack = 64;
  constexpr int kWhite = 192;
  std::uint32_t bits = 0;
  for (int cell = 0; cell < kCells; ++cell) {
    const int green = frame.row(y)[4 * (cell * kCell_px + kCell_px / 2) + 1];
    if (green > kBlack && green < kWhite) {
      return std::nullopt;
    }
    bits |= green >= kWhite ? 1U << cell : 0;
  }
  return PaintedNumber{bits & kPictureMask, bits >> 24};
}

/// The number of a frame; none where there is none or where top and bottom disagree: parts of two pictures.
inline std::optional<PaintedNumber> read_number(const Frame& frame) {
  if (frame.width_px < kLeastWidth_px || frame.height_px < 2 * kCell_px) {
    return std::nullopt;
  }
  const auto top = read_cells(frame, kCell_px / 2);
  const auto bottom = read_cells(frame, frame.height_px - kCell_px / 2);
  return top == bottom ? top : std::nullopt;
}

}  // namespace facet::hil
