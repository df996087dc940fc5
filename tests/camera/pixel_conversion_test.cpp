#include "camera/pixel_conversion.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <vector>

namespace facet::camera {
namespace {

using testing::ElementsAre;
using testing::ElementsAreArray;

constexpr std::uint8_t kSentinel = 0xA5;

/// Converts into rows that are padded by 8 bytes, which must stay as they were; the pixels without the
/// padding.
std::vector<int> convert(PixelLayout layout, const ColourCoding& coding,
                         const std::vector<std::uint8_t>& picture, std::size_t stride, int width,
                         int height) {
  EXPECT_EQ(picture.size(), picture_bytes(layout, width, height, stride));
  const std::size_t row = 4 * static_cast<std::size_t>(width);
  std::vector<std::uint8_t> rgba((row + 8) * static_cast<std::size_t>(height), kSentinel);
  convert_to_rgba({layout, coding, picture.data(), stride, width, height, nullptr}, rgba.data(), row + 8);
  std::vector<int> pixels;
  for (std::size_t i = 0; i < rgba.size(); ++i) {
    if (i % (row + 8) < row) {
      pixels.push_back(rgba[i]);
    } else {
      EXPECT_EQ(rgba[i], kSentinel) << "byte " << i;
    }
  }
  return pixels;
}

constexpr ColourCoding kFull601{0.299, 0.114, true};
constexpr ColourCoding kLimited601{0.299, 0.114, false};
constexpr ColourCoding kLimited709{0.2126, 0.0722, false};

// Worked out by hand from the matrices in ITU-R BT.601 and BT.709 (section 3 of each):
// limited 601: R = 1.16438 (Y-16) + 1.59603 (V-128), G = .. - 0.39176 (U-128) - 0.81297 (V-128), B = ..
// + 2.01723 (U-128) limited 709: R = .. + 1.79274 (V-128), G = .. - 0.21325 (U-128) - 0.53291 (V-128), B = ..
// + 2.11240 (U-128)
TEST(PixelConversion, YuyvOfEveryMatrixAndRange) {
  const std::vector<std::uint8_t> pair = {81, 90, 145, 240};  // Y U Y V
  EXPECT_THAT(convert(PixelLayout::Yuyv, kLimited601, pair, 4, 2, 1),
              ElementsAre(254, 0, 0, 255, 255, 74, 74, 255));
  EXPECT_THAT(convert(PixelLayout::Yuyv, kLimited709, pair, 4, 2, 1),
              ElementsAre(255, 24, 0, 255, 255, 99, 70, 255));
  // Full range: R = Y + 1.402 (V-128), G = Y - 0.344136 (U-128) - 0.714136 (V-128), B = Y + 1.772 (U-128).
  EXPECT_THAT(convert(PixelLayout::Yuyv, kFull601, {76, 85, 150, 255}, 4, 2, 1),
              ElementsAre(254, 0, 0, 255, 255, 74, 74, 255));
}

TEST(PixelConversion, BlackAndWhiteOfBothRanges) {
  EXPECT_THAT(convert(PixelLayout::Yuyv, kLimited601, {16, 128, 235, 128}, 4, 2, 1),
              ElementsAre(0, 0, 0, 255, 255, 255, 255, 255));
  EXPECT_THAT(convert(PixelLayout::Yuyv, kFull601, {0, 128, 255, 128}, 4, 2, 1),
              ElementsAre(0, 0, 0, 255, 255, 255, 255, 255));
}

TEST(PixelConversion, YuyvOfAnOddWidthHasAWholeLastPair) {
  EXPECT_THAT(convert(PixelLayout::Yuyv, kFull601, {10, 128, 20, 128, 30, 128, 99, 128}, 8, 3, 1),
              ElementsAre(10, 10, 10, 255, 20, 20, 20, 255, 30, 30, 30, 255));
}

/// Rows are padded by two bytes; four pixels share their chroma; width and height are odd.
TEST(PixelConversion, Nv12) {
  constexpr std::uint8_t kPadding = 77;
  const std::vector<std::uint8_t> picture = {
      10,  20,  30,  0,   kPadding, kPadding,  // luma
      40,  50,  60,  0,   kPadding, kPadding,  //
      76,  76,  76,  0,   kPadding, kPadding,  //
      128, 128, 128, 128, kPadding, kPadding,  // U V of rows 0 and 1
      85,  255, 128, 128,                      // U V of row 2
  };
  EXPECT_THAT(convert(PixelLayout::Nv12, kFull601, picture, 6, 3, 3),
              ElementsAreArray({10,  10, 10, 255, 20,  20, 20, 255, 30, 30, 30, 255,  //
                                40,  40, 40, 255, 50,  50, 50, 255, 60, 60, 60, 255,  //
                                254, 0,  0,  255, 254, 0,  0,  255, 76, 76, 76, 255}));
}

/// libcamera hands out planes that need not follow one another.
TEST(PixelConversion, Nv12WhosePlanesLieApart) {
  const std::vector<std::uint8_t> luma = {76, 76, 150, 150};
  const std::vector<std::uint8_t> chroma = {85, 255};
  std::array<std::uint8_t, 16> rgba{};
  convert_to_rgba({PixelLayout::Nv12, kFull601, luma.data(), 2, 2, 2, chroma.data()}, rgba.data(), 8);
  EXPECT_THAT(rgba, ElementsAre(254, 0, 0, 255, 254, 0, 0, 255, 255, 74, 74, 255, 255, 74, 74, 255));
}

TEST(PixelConversion, ColoursInEveryOrder) {
  const auto twice = ElementsAre(1, 2, 3, 255, 4, 5, 6, 255, 7, 8, 9, 255, 10, 11, 12, 255);
  constexpr std::uint8_t kPadding = 77;
  EXPECT_THAT(convert(PixelLayout::Rgb, {}, {1, 2, 3, 4, 5, 6, kPadding, 7, 8, 9, 10, 11, 12}, 7, 2, 2),
              twice);
  EXPECT_THAT(convert(PixelLayout::Bgr, {}, {3, 2, 1, 6, 5, 4, kPadding, 9, 8, 7, 12, 11, 10}, 7, 2, 2),
              twice);
  EXPECT_THAT(convert(PixelLayout::Rgbx, {}, {1, 2, 3, 0, 4, 5, 6, 0, 7, 8, 9, 0, 10, 11, 12, 0}, 8, 2, 2),
              twice);
  EXPECT_THAT(convert(PixelLayout::Bgrx, {}, {3, 2, 1, 0, 6, 5, 4, 0, 9, 8, 7, 0, 12, 11, 10, 0}, 8, 2, 2),
              twice);
}

TEST(PixelConversion, GreyOfEightTenAndSixteenBits) {
  EXPECT_THAT(convert(PixelLayout::Grey, kFull601, {0, 7, 255}, 3, 3, 1),
              ElementsAre(0, 0, 0, 255, 7, 7, 7, 255, 255, 255, 255, 255));
  // (128 - 16) 255 / 219 = 130.4; (100 - 16) 255 / 219 = 97.8
  EXPECT_THAT(convert(PixelLayout::Grey, kLimited601, {128, 100, 3}, 3, 3, 1),
              ElementsAre(130, 130, 130, 255, 98, 98, 98, 255, 0, 0, 0, 255));
  // 1023 is white; 512 255 / 1023 = 127.6; 2 255 / 1023 = 0.4985
  EXPECT_THAT(convert(PixelLayout::Y10, kFull601, {0xFF, 0x03, 0x00, 0x02, 0x02, 0x00}, 6, 3, 1),
              ElementsAre(255, 255, 255, 255, 128, 128, 128, 255, 0, 0, 0, 255));
  // 940 is white, 64 black, 502 = 50 %: 127.5
  EXPECT_THAT(convert(PixelLayout::Y10, kLimited601, {0xAC, 0x03, 0x40, 0x00, 0xF6, 0x01}, 6, 3, 1),
              ElementsAre(255, 255, 255, 255, 0, 0, 0, 255, 128, 128, 128, 255));
  // 65535 is white; 0x8000 255 / 65535 = 127.502; 385 = 1.498
  EXPECT_THAT(convert(PixelLayout::Y16, kFull601, {0xFF, 0xFF, 0x00, 0x80, 0x81, 0x01}, 6, 3, 1),
              ElementsAre(255, 255, 255, 255, 128, 128, 128, 255, 1, 1, 1, 255));
  // 0xEB00 is white, 0x1000 black
  EXPECT_THAT(convert(PixelLayout::Y16, kLimited601, {0x00, 0xEB, 0x00, 0x10}, 4, 2, 1),
              ElementsAre(255, 255, 255, 255, 0, 0, 0, 255));
}

}  // namespace
}  // namespace facet::camera
