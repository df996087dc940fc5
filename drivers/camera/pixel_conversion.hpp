#pragma once

#include <cstddef>
#include <cstdint>

namespace facet::camera {

/// Uncompressed pictures of cameras, named as V4L2 names them (YUYV 4:2:2 packed, NV12 4:2:0 in two planes,
/// grey of 8, 10 and 16 bits a pixel; the last two are 16-bit little-endian words), or colours by the order
/// of their bytes in memory.
enum class PixelLayout { Yuyv, Nv12, Grey, Y10, Y16, Rgb, Bgr, Rgbx, Bgrx };

/// How Y'CbCr or grey values stand for colours.
struct ColourCoding {
  double red_share = 0.299;   ///< of luma: Kr; 0.299 in BT.601, 0.2126 in BT.709
  double blue_share = 0.114;  ///< Kb; 0.114 in BT.601, 0.0722 in BT.709
  /// 0 to 255; else luma 16 to 235, chroma 16 to 240 (times 4 or 256 for more bits).
  bool full_range = false;
};

/// Bytes between rows of a picture whose driver does not pad them; of the first plane.
std::size_t packed_stride_bytes(PixelLayout layout, int width_px);

/// Bytes that a picture has at least, the padding of its last row left out.
std::size_t picture_bytes(PixelLayout layout, int width_px, int height_px, std::size_t stride_bytes);

/// A picture as a camera's driver gives it.
struct RawPicture {
  PixelLayout layout = PixelLayout::Grey;
  ColourCoding coding;
  const std::uint8_t* bytes = nullptr;  ///< [picture_bytes(...)]
  std::size_t stride_bytes = 0;         ///< from row to row
  int width_px = 0;
  int height_px = 0;
  /// NV12: the second plane, with the same stride; null: it follows the height_px rows of the first.
  const std::uint8_t* chroma = nullptr;
};

/// Converts to 8-bit R G B A (A = 255). Chroma is not interpolated: it differs by half a pixel at most.
///
/// rgba     [height_px][rgba_stride_bytes], rgba_stride_bytes >= 4 * width_px
void convert_to_rgba(const RawPicture& picture, std::uint8_t* rgba, std::size_t rgba_stride_bytes);

}  // namespace facet::camera
