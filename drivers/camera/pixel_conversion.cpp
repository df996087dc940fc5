#include "camera/pixel_conversion.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace facet::camera {
namespace {

/// Fixed point with 16 bits behind the point.
constexpr int kShift = 16;
constexpr int kHalf = 1 << (kShift - 1);

int fixed(double value) {
  return static_cast<int>(std::lround(value * (1 << kShift)));
}

std::uint8_t to_byte(int fixed_value) {
  return static_cast<std::uint8_t>(std::clamp((fixed_value + kHalf) >> kShift, 0, 255));
}

/// R = y Y + rv V, G = y Y - gu U - gv V, B = y Y + bu U with Y, U, V freed of their offsets (ITU-R BT.601
/// and BT.709, sections 3).
struct Matrix {
  explicit Matrix(const ColourCoding& coding) {
    const double luma = coding.full_range ? 1.0 : 255.0 / 219.0;
    const double chroma = coding.full_range ? 1.0 : 255.0 / 224.0;
    const double green_share = 1 - coding.red_share - coding.blue_share;
    const double red = 2 * (1 - coding.red_share) * chroma;
    const double blue = 2 * (1 - coding.blue_share) * chroma;
    black = coding.full_range ? 0 : 16;
    y = fixed(luma);
    rv = fixed(red);
    gu = fixed(blue * coding.blue_share / green_share);
    gv = fixed(red * coding.red_share / green_share);
    bu = fixed(blue);
  }
  int black, y, rv, gu, gv, bu;
};

/// One row; the samples of luma and chroma lie LumaStep and ChromaStep bytes apart, two pixels share their
/// chroma.
template <int LumaStep, int ChromaStep>
void convert_row(const Matrix& matrix, const std::uint8_t* luma, const std::uint8_t* cb,
                 const std::uint8_t* cr, int width_px, std::uint8_t* rgba) {
  for (int x = 0; x < width_px; x += 2) {
    const int u = *cb - 128;
    const int v = *cr - 128;
    const int red = matrix.rv * v;
    const int green = -matrix.gu * u - matrix.gv * v;
    const int blue = matrix.bu * u;
    for (int pixel = 0; pixel < std::min(2, width_px - x); ++pixel) {
      const int y = (*luma - matrix.black) * matrix.y;
      rgba[0] = to_byte(y + red);
      rgba[1] = to_byte(y + green);
      rgba[2] = to_byte(y + blue);
      rgba[3] = 255;
      luma += LumaStep;
      rgba += 4;
    }
    cb += ChromaStep;
    cr += ChromaStep;
  }
}

void write_grey(std::uint8_t* rgba, std::uint8_t value) {
  rgba[0] = value;
  rgba[1] = value;
  rgba[2] = value;
  rgba[3] = 255;
}

/// Grey of `bits` bits as 8-bit grey.
struct GreyScale {
  GreyScale(int bits, bool full_range)
      : black(full_range ? 0.0F : static_cast<float>(16 << (bits - 8))),
        scale(255.0F / static_cast<float>(full_range ? (1 << bits) - 1 : 219 << (bits - 8))) {}
  std::uint8_t operator()(int value) const {
    return static_cast<std::uint8_t>(
        std::clamp((static_cast<float>(value) - black) * scale + 0.5F, 0.0F, 255.0F));
  }
  float black, scale;
};

void convert_grey_words(const GreyScale& scale, const std::uint8_t* words, int width_px, std::uint8_t* rgba) {
  for (int x = 0; x < width_px; ++x) {
    write_grey(rgba, scale(words[0] | words[1] << 8));
    words += 2;
    rgba += 4;
  }
}

/// One row of colours; red and blue stand at their places in the bytes of a pixel.
template <int PixelBytes, int Red, int Blue>
void reorder_row(const std::uint8_t* row, int width_px, std::uint8_t* rgba) {
  for (int x = 0; x < width_px; ++x) {
    rgba[0] = row[Red];
    rgba[1] = row[1];
    rgba[2] = row[Blue];
    rgba[3] = 255;
    row += PixelBytes;
    rgba += 4;
  }
}

}  // namespace

std::size_t packed_stride_bytes(PixelLayout layout, int width_px) {
  const auto width = static_cast<std::size_t>(width_px);
  switch (layout) {
    case PixelLayout::Grey:
      return width;
    case PixelLayout::Nv12:
      return (width + 1) / 2 * 2;
    case PixelLayout::Yuyv:
      return (width + 1) / 2 * 4;
    case PixelLayout::Rgb:
    case PixelLayout::Bgr:
      return 3 * width;
    case PixelLayout::Rgbx:
    case PixelLayout::Bgrx:
      return 4 * width;
    default:
      return 2 * width;
  }
}

std::size_t picture_bytes(PixelLayout layout, int width_px, int height_px, std::size_t stride_bytes) {
  const auto height = static_cast<std::size_t>(height_px);
  const std::size_t rows = layout == PixelLayout::Nv12 ? height + (height + 1) / 2 : height;
  return (rows - 1) * stride_bytes + packed_stride_bytes(layout, width_px);
}

void convert_to_rgba(const RawPicture& picture, std::uint8_t* rgba, std::size_t rgba_stride_bytes) {
  const int width_px = picture.width_px;
  const bool full_range = picture.coding.full_range;
  const Matrix matrix(picture.coding);
  const GreyScale ten_bits(10, full_range);
  const GreyScale sixteen_bits(16, full_range);
  std::array<std::uint8_t, 256> eight_bits{};
  for (int value = 0; value < 256; ++value) {
    eight_bits[static_cast<std::size_t>(value)] = GreyScale(8, full_range)(value);
  }
  const std::uint8_t* chroma_plane =
      picture.chroma != nullptr
          ? picture.chroma
          : picture.bytes + static_cast<std::size_t>(picture.height_px) * picture.stride_bytes;
  for (int y = 0; y < picture.height_px; ++y) {
    const std::uint8_t* row = picture.bytes + static_cast<std::size_t>(y) * picture.stride_bytes;
    std::uint8_t* out = rgba + static_cast<std::size_t>(y) * rgba_stride_bytes;
    switch (picture.layout) {
      case PixelLayout::Yuyv:
        convert_row<2, 4>(matrix, row, row + 1, row + 3, width_px, out);
        break;
      case PixelLayout::Nv12: {
        const std::uint8_t* chroma = chroma_plane + static_cast<std::size_t>(y / 2) * picture.stride_bytes;
        convert_row<1, 2>(matrix, row, chroma, chroma + 1, width_px, out);
        break;
      }
      case PixelLayout::Grey:
        for (int x = 0; x < width_px; ++x) {
          write_grey(out, eight_bits[row[x]]);
          out += 4;
        }
        break;
      case PixelLayout::Y10:
        convert_grey_words(ten_bits, row, width_px, out);
        break;
      case PixelLayout::Y16:
        convert_grey_words(sixteen_bits, row, width_px, out);
        break;
      case PixelLayout::Rgb:
        reorder_row<3, 0, 2>(row, width_px, out);
        break;
      case PixelLayout::Bgr:
        reorder_row<3, 2, 0>(row, width_px, out);
        break;
      case PixelLayout::Rgbx:
        reorder_row<4, 0, 2>(row, width_px, out);
        break;
      case PixelLayout::Bgrx:
        reorder_row<4, 2, 0>(row, width_px, out);
        break;
    }
  }
}

}  // namespace facet::camera
