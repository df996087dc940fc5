#include "camera/jpeg_decoder.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <vector>

#include "support/jpeg_picture.hpp"

namespace facet::camera {
namespace {

constexpr int kWidth_px = 36;
constexpr int kHeight_px = 20;
constexpr std::size_t kStride_bytes = 4 * kWidth_px + 16;
constexpr std::uint8_t kSentinel = 0xA5;
constexpr std::array<std::uint8_t, 2> kTable = {0xFF, 0xDB};  // DQT
constexpr std::array<std::uint8_t, 2> kFrame = {0xFF, 0xC0};  // SOF0

class JpegDecoderTest : public testing::Test {
 protected:
  JpegOutcome decode(const std::vector<std::uint8_t>& jpeg) {
    std::fill(rgba_.begin(), rgba_.end(), kSentinel);
    return decoder_.decode(jpeg, kWidth_px, kHeight_px, rgba_.data(), kStride_bytes);
  }
  void expect_orange() const {
    for (std::size_t y = 0; y < kHeight_px; ++y) {
      const std::uint8_t* row = rgba_.data() + y * kStride_bytes;
      for (std::size_t x = 0; x < kWidth_px; ++x) {
        ASSERT_NEAR(row[4 * x], 220, 2) << x << ", " << y;
        ASSERT_NEAR(row[4 * x + 1], 120, 2) << x << ", " << y;
        ASSERT_NEAR(row[4 * x + 2], 40, 2) << x << ", " << y;
        ASSERT_EQ(row[4 * x + 3], 255) << x << ", " << y;
      }
      for (std::size_t i = 4 * kWidth_px; i < kStride_bytes; ++i) {
        ASSERT_EQ(row[i], kSentinel) << "behind row " << y;
      }
    }
  }

  std::vector<std::uint8_t> orange_ = test::jpeg_of({220, 120, 40}, kWidth_px, kHeight_px);
  std::vector<std::uint8_t> rgba_ = std::vector<std::uint8_t>(kStride_bytes * kHeight_px);
  JpegDecoder decoder_;
};

TEST_F(JpegDecoderTest, DecodesToRgba) {
  EXPECT_EQ(decode(orange_), JpegOutcome::Whole);
  expect_orange();
}

TEST_F(JpegDecoderTest, DecodesWithoutHuffmanTables) {
  const auto bare = test::without_huffman_tables(orange_);
  ASSERT_LT(bare.size(), orange_.size() - 300);
  EXPECT_EQ(decode(bare), JpegOutcome::Whole);
  expect_orange();
}

TEST_F(JpegDecoderTest, LeavesAloneWhatFollowsThePicture) {
  orange_.resize(orange_.size() + 100, 0);
  EXPECT_EQ(decode(orange_), JpegOutcome::Whole);
  expect_orange();
}

TEST_F(JpegDecoderTest, APictureCutShortIsDamaged) {
  orange_.resize(orange_.size() - 10);
  EXPECT_EQ(decode(orange_), JpegOutcome::Damaged);
}

/// A quantization table is cut out: the decoder learns of it after it has warned of something else.
TEST_F(JpegDecoderTest, WhatBreaksOffAfterAWarningIsUnreadable) {
  const std::vector<std::uint8_t> nonsense = {0xFF, 0xD8, 0x00, 0x11,
                                              0x22};  // warned of, between two markers
  std::vector<std::uint8_t> broken(nonsense);
  const auto tables = std::search(orange_.begin(), orange_.end(), kTable.begin(), kTable.end());
  const auto frame = std::search(orange_.begin(), orange_.end(), kFrame.begin(), kFrame.end());
  ASSERT_LT(tables, frame);
  broken.insert(broken.end(), orange_.begin() + 2, tables);
  broken.insert(broken.end(), frame, orange_.end());
  EXPECT_EQ(decode(broken), JpegOutcome::Unreadable);
}

TEST_F(JpegDecoderTest, WhatIsNoPictureOfTheSizeIsUnreadable) {
  EXPECT_EQ(decode({}), JpegOutcome::Unreadable);
  EXPECT_EQ(decode({0xFF, 0xD8}), JpegOutcome::Unreadable);
  EXPECT_EQ(decode(std::vector<std::uint8_t>(1000, 0x55)), JpegOutcome::Unreadable);
  EXPECT_EQ(decode(test::jpeg_of({1, 2, 3}, kWidth_px + 1, kHeight_px)), JpegOutcome::Unreadable);
  EXPECT_EQ(decode(test::jpeg_of({1, 2, 3}, kWidth_px, kHeight_px - 1)), JpegOutcome::Unreadable);
  EXPECT_EQ(decode(test::jpeg_of({1, 2, 3}, kWidth_px, kHeight_px, true)), JpegOutcome::Unreadable);
  orange_.resize(40);
  EXPECT_EQ(decode(orange_), JpegOutcome::Unreadable);
  EXPECT_EQ(decode(test::jpeg_of({220, 120, 40}, kWidth_px, kHeight_px)), JpegOutcome::Whole)
      << "the decoder goes on after a broken one";
  expect_orange();
}

}  // namespace
}  // namespace facet::camera
