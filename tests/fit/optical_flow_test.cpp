#include "fit/optical_flow.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "facet/error.hpp"
#include "fit/reference_picture.hpp"

namespace facet::fit {
namespace {

/// A picture of a smooth function.
Frame painted(int width, int height, const std::function<float(float, float)>& grey) {
  Frame frame;
  frame.width_px = width;
  frame.height_px = height;
  frame.stride_bytes = 4 * static_cast<std::size_t>(width);
  auto pixels = std::make_shared<std::uint8_t[]>(frame.stride_bytes * static_cast<std::size_t>(height));
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      std::uint8_t* at =
          pixels.get() + static_cast<std::size_t>(y) * frame.stride_bytes + 4 * static_cast<std::size_t>(x);
      at[0] = at[1] = at[2] =
          static_cast<std::uint8_t>(std::lround(grey(static_cast<float>(x), static_cast<float>(y))));
      at[3] = 255;
    }
  }
  frame.pixels = std::move(pixels);
  return frame;
}

float texture(float x, float y) {
  return 128 + 40 * std::sin(0.21F * x + 0.4F * std::sin(0.07F * y)) +
         40 * std::sin(0.17F * y + 0.5F * std::cos(0.05F * x));
}

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

/// A plate in front of a camera that shows (x, y, 500 mm) at (x + 80, y + 60).
TEST(ReferencePicture, DrawsTheSkinWhereTheMeshIs) {
  capture::Lens lens;
  lens.width_px = 160;
  lens.height_px = 120;
  lens.fx_px = lens.fy_px = 500;
  lens.cx_px = 80;
  lens.cy_px = 60;
  mesh::Vertices plate(3, 4);
  plate << -40, 40, 40, -40, -30, -30, 30, 30, 500, 500, 500, 500;
  mesh::Triangles triangles(3, 2);
  triangles << 0, 0, 1, 2, 2, 3;
  const std::vector<std::uint8_t> all(4, 1);
  const ReferencePicture reference(lens, painted(160, 120, texture), plate, triangles, all);
  const mesh::Vertices moved = plate.colwise() + Eigen::Vector3f(7, -4, 0);
  std::vector<std::uint8_t> drawn;
  const Frame now = painted(160, 120, [](float, float) { return 10.0F; });
  const Frame shown = reference.draw(now, moved, all, drawn);
  for (int y = 0; y < 120; ++y) {
    for (int x = 0; x < 160; ++x) {
      const bool inside = x > 48 && x < 126 && y > 27 && y < 85;
      const bool outside = x < 46 || x > 128 || y < 25 || y > 87;
      const int value = shown.row(y)[4 * x];
      if (inside) {
        ASSERT_NEAR(value, texture(static_cast<float>(x) - 7, static_cast<float>(y) + 4), 1.01F)
            << x << ", " << y;
        ASSERT_EQ(drawn[static_cast<std::size_t>(y) * 160 + static_cast<std::size_t>(x)], 1);
      } else if (outside) {
        ASSERT_EQ(value, 10) << x << ", " << y;
        ASSERT_EQ(drawn[static_cast<std::size_t>(y) * 160 + static_cast<std::size_t>(x)], 0);
      }
    }
  }
  // A vertex that is not seen takes its triangles with it.
  std::vector<std::uint8_t> hidden = all;
  hidden[1] = 0;
  reference.draw(now, moved, hidden, drawn);
  EXPECT_EQ(drawn[40 * 160 + 110], 0) << "the triangle at the hidden corner";
  EXPECT_EQ(drawn[70 * 160 + 60], 1) << "the other one";
}

}  // namespace
}  // namespace facet::fit
