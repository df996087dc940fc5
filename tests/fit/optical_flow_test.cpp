#include "fit/optical_flow.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "facet/error.hpp"
#include "painted_picture.hpp"

namespace facet::fit {
namespace {

constexpr PixelBox kWhole{0, 0, 160, 120};

TEST(OpticalFlow, FindsAShiftToAFractionOfAPixel) {
  const Frame earlier = painted(160, 120, texture);
  const Frame later = painted(160, 120, [](float x, float y) { return texture(x - 3.4F, y + 1.7F); });
  OpticalFlow flow;
  Flow found;
  flow.find(earlier, later, kWhole, found);
  double worst = 0;
  for (int y = 20; y < 100; ++y) {
    for (int x = 20; x < 140; ++x) {
      const auto at = static_cast<std::size_t>(y) * 160 + static_cast<std::size_t>(x);
      worst = std::max(worst, static_cast<double>((found.flow_px[at] - Eigen::Vector2f(3.4F, -1.7F)).norm()));
      EXPECT_GT(found.confidence[at], 0.5F);
    }
  }
  EXPECT_LT(worst, 0.3);
}

TEST(OpticalFlow, KnowsNothingBesideItsBox) {
  const Frame earlier = painted(160, 120, texture);
  const Frame later = painted(160, 120, [](float x, float y) { return texture(x - 3.4F, y + 1.7F); });
  OpticalFlow flow;
  Flow found;
  flow.find(earlier, later, {50, 10, 80, 70}, found);
  int known = 0;
  for (int y = 0; y < 120; ++y) {
    for (int x = 0; x < 160; ++x) {
      const auto at = static_cast<std::size_t>(y) * 160 + static_cast<std::size_t>(x);
      if (x < 50 || x >= 130 || y < 10 || y >= 80) {
        ASSERT_EQ(found.confidence[at], 0) << x << ", " << y;
      } else if (x >= 60 && x < 120 && y >= 20 && y < 70) {
        EXPECT_LT((found.flow_px[at] - Eigen::Vector2f(3.4F, -1.7F)).norm(), 0.3F) << x << ", " << y;
        known += found.confidence[at] > 0.5F ? 1 : 0;
      }
    }
  }
  EXPECT_EQ(known, 60 * 50);
  // Too small a box at the rim, and one of nothing.
  flow.find(earlier, later, {155, 115, 2, 0}, found);
  EXPECT_GT(found.confidence[90 * 160 + 130], 0.5F);
  EXPECT_EQ(found.confidence[50 * 160 + 130], 0);
}

TEST(OpticalFlow, WhatIsGoneIsNotTrusted) {
  const Frame earlier = painted(160, 120, texture);
  const Frame later = painted(160, 120, [](float x, float y) {
    return x > 60 && x < 110 && y > 40 && y < 90 ? 128 + 60 * std::sin(0.9F * x * y) : texture(x - 2, y);
  });
  OpticalFlow flow;
  Flow found;
  flow.find(earlier, later, kWhole, found);
  double trusted = 0;
  for (int y = 48; y < 82; ++y) {
    for (int x = 68; x < 102; ++x) {
      trusted += static_cast<double>(
          found.confidence[static_cast<std::size_t>(y) * 160 + static_cast<std::size_t>(x)]);
    }
  }
  EXPECT_LT(trusted / (34 * 34), 0.4);
  EXPECT_GT(found.confidence[60 * 160 + 30], 0.5F);
}

TEST(OpticalFlow, DifferentSizesAreRefused) {
  OpticalFlow flow;
  Flow found;
  EXPECT_THAT([&] { flow.find(painted(64, 48, texture), painted(80, 48, texture), kWhole, found); },
              ::testing::ThrowsMessage<Error>(::testing::HasSubstr("64x48 and 80x48")));
  EXPECT_THROW(flow.find(Frame(), Frame(), kWhole, found), Error);
}

}  // namespace
}  // namespace facet::fit
