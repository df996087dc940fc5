#include "landmark/region.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "support/frames.hpp"

namespace facet::landmark {
namespace {

using test::make_frame;

std::vector<float> sample(const Frame& frame, const Region& region, Border border, int side) {
  std::vector<float> planar(3 * static_cast<std::size_t>(side) * static_cast<std::size_t>(side),
                            std::numeric_limits<float>::quiet_NaN());
  RegionSampler(side).sample(frame, region, border, 1.0F, 0.0F, planar);
  return planar;
}

/// Red rises with x, green with y, blue is constant.
Frame ramp(int width, int height) {
  return make_frame(
      width, height,
      [](int x, int y) { return cv::Vec3b(static_cast<std::uint8_t>(x), static_cast<std::uint8_t>(y), 7); },
      12);
}

TEST(Region, MapsWindowToImage) {
  const Region region{{100, 50}, 20, 0.5F};
  EXPECT_TRUE(region.image_from_window({0.5F, 0.5F}).isApprox(region.centre_px));
  EXPECT_NEAR((region.image_from_window({1, 0}) - region.image_from_window({0, 0})).norm(), 20, 1e-4);
  const Eigen::Vector2f along = region.image_from_window({1, 0.5F}) - region.centre_px;
  EXPECT_NEAR(std::atan2(along.y(), along.x()), 0.5F, 1e-5);
}

TEST(Region, MapsANetsPointsAsItMapsTheWindow) {
  const Region region{{100, 50}, 48, 0.7F};
  constexpr int side = 192;
  Eigen::Matrix3Xf net_px(3, 2);
  net_px << 0, 150, 192, 30, 8, -4;
  Eigen::Matrix3Xf image_px;
  region.image_from_net(net_px, side, image_px);
  ASSERT_EQ(image_px.cols(), 2);
  for (Eigen::Index point = 0; point < 2; ++point) {
    const Eigen::Vector2f window = net_px.col(point).head<2>() / side;
    EXPECT_TRUE(image_px.col(point).head<2>().isApprox(region.image_from_window(window), 1e-5F)) << point;
    EXPECT_FLOAT_EQ(image_px(2, point), net_px(2, point) * 48 / side) << point;
  }
}

TEST(RegionSampler, ReproducesALinearImageUnderAnySimilarity) {
  constexpr int side = 32;
  const Frame frame = ramp(211, 173);
  for (const float size : {5.0F, 32.0F, 47.3F, 64.0F, 97.0F, 131.0F}) {
    for (const float rotation : {0.0F, 0.3F, -2.0F}) {
      const Region region{{104.3F, 85.6F}, size, rotation};
      // Within 0.6: averages are rounded to bytes. A position that is off by half a pixel of the window would
      // show.
      const float tolerance = size < 1.5F * side ? 2e-3F : 0.6F;
      const auto planar = sample(frame, region, Border::Black, side);
      for (int row = 0; row < side; ++row) {
        for (int column = 0; column < side; ++column) {
          const Eigen::Vector2f expected = region.image_from_window(
              {(static_cast<float>(column) + 0.5F) / side, (static_cast<float>(row) + 0.5F) / side});
          const auto at = static_cast<std::size_t>(row * side + column);
          ASSERT_NEAR(planar[at], expected.x(), tolerance) << size << " " << rotation;
          ASSERT_NEAR(planar[side * side + at], expected.y(), tolerance) << size << " " << rotation;
          ASSERT_NEAR(planar[2 * side * side + at], 7, 1e-3);
        }
      }
    }
  }
}

TEST(RegionSampler, AveragesWhatItMinifies) {
  // A checkerboard of single pixels is grey from afar, whatever its phase.
  const Frame frame = make_frame(400, 400, [](int x, int y) {
    const auto value = static_cast<std::uint8_t>((x + y) % 2 == 0 ? 0 : 200);
    return cv::Vec3b(value, value, value);
  });
  for (const float shift : {0.0F, 0.25F, 0.5F, 1.0F}) {
    for (const float value : sample(frame, {{200 + shift, 200}, 320, 0}, Border::Black, 16)) {
      ASSERT_NEAR(value, 100, 1.0F);
    }
  }
}

TEST(RegionSampler, RepeatsOrBlackensTheBorder) {
  const Frame frame = make_frame(10, 6, [](int, int) { return cv::Vec3b(50, 60, 70); });
  for (const float size : {20.0F, 300.0F, 2000.0F}) {
    const Region around{{4.5F, 2.5F}, size, 0};
    for (const float value : sample(frame, around, Border::Replicate, 20)) {
      ASSERT_TRUE(value > 49.9F && value < 70.1F) << size;
    }
  }
  const auto black = sample(frame, {{4.5F, 2.5F}, 20, 0}, Border::Black, 20);
  EXPECT_EQ(black[0], 0);
  EXPECT_NEAR(black[10 * 20 + 10], 50, 1e-3);
  int inside = 0;
  for (std::size_t i = 0; i < 400; ++i) {
    inside += black[i] > 0 ? 1 : 0;
  }
  EXPECT_EQ(inside, 60);
}

TEST(RegionSampler, ReadsOnlyTheFrame) {
  // Windows in all places and of all sizes on frames of all shapes; the address sanitizer watches.
  for (const auto& [width, height] : {std::pair{1, 1}, {16, 16}, {13, 127}, {640, 3}}) {
    const Frame frame = make_frame(width, height, [](int, int) { return cv::Vec3b(9, 9, 9); });
    for (const float size : {0.5F, 7.0F, 128.0F, 5000.0F}) {
      for (const float x : {-1e5F, -3.0F, 0.0F, 8.0F, 700.0F}) {
        for (const float y : {-40.0F, 0.0F, 126.4F, 1e5F}) {
          for (const float value : sample(frame, {{x, y}, size, 0.7F}, Border::Replicate, 24)) {
            ASSERT_NEAR(value, 9, 1e-3);
          }
        }
      }
    }
  }
}

TEST(RegionSampler, ScalesAndOffsets) {
  const Frame frame = make_frame(8, 8, [](int, int) { return cv::Vec3b(255, 0, 51); });
  std::vector<float> planar(3 * 4);
  RegionSampler(2).sample(frame, {{3.5F, 3.5F}, 4, 0}, Border::Black, 1 / 127.5F, -1, planar);
  EXPECT_NEAR(planar[0], 1, 1e-5);
  EXPECT_NEAR(planar[4], -1, 1e-5);
  EXPECT_NEAR(planar[8], -0.6F, 1e-5);
}

}  // namespace
}  // namespace facet::landmark
