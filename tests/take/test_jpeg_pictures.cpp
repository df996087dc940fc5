// Pictures that a take holds as JPEG.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <vector>

#include "facet/error.hpp"
#include "record_take.hpp"
#include "take/picture_records.hpp"

namespace facet::take {
namespace {

TEST(JpegRecords, APictureComesBackNearlyAsItWas) {
  constexpr int kWidth_px = 160;
  constexpr int kHeight_px = 91;
  for (const bool grey : {false, true}) {
    FrameSet set;
    set.slot = 7;
    Frame& picture = set.frames.emplace_back(test::noisy_picture(kWidth_px, kHeight_px, grey, 1));
    auto pixels = std::make_shared<std::uint8_t[]>(picture.stride_bytes * kHeight_px, std::uint8_t{255});
    for (int y = 0; y < kHeight_px; ++y) {
      for (int x = 0; x < kWidth_px; ++x) {
        std::uint8_t* rgb = pixels.get() + static_cast<std::size_t>(y) * picture.stride_bytes +
                            std::size_t{4} * static_cast<std::size_t>(x);
        rgb[0] = static_cast<std::uint8_t>(x + 40);
        rgb[1] = grey ? rgb[0] : static_cast<std::uint8_t>(y + 60);
        rgb[2] = grey ? rgb[0] : std::uint8_t{90};
      }
    }
    picture.pixels = std::move(pixels);
    std::vector<std::uint8_t> records;
    ASSERT_TRUE(PictureWriter(PictureCoding::Jpeg).append(set, 5, records));
    FrameSet got = set;
    got.frames[0].pixels = nullptr;
    got.frames[0].stride_bytes = std::size_t{4} * kWidth_px;
    PictureReader().read(records, 5, got);
    int worst = 0;
    for (int y = 0; y < kHeight_px; ++y) {
      for (int k = 0; k < 4 * kWidth_px; ++k) {
        worst = std::max(worst, std::abs(got.frames[0].row(y)[k] - picture.row(y)[k]));
      }
    }
    EXPECT_LE(worst, 6) << (grey ? "grey" : "colour");
    EXPECT_LT(records.size(), std::size_t{kWidth_px} * kHeight_px / 4);

    FrameSet other = got;
    other.frames[0].pixels = nullptr;
    other.frames[0].width_px = kWidth_px - 1;
    EXPECT_THROW(PictureReader().read(records, 5, other), Error);
  }
}

}  // namespace
}  // namespace facet::take
