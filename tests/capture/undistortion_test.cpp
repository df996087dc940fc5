// What a distorted lens saw, as a straight one would have.

#include "capture/undistortion.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace facet::capture {
namespace {

/// Red grows to the right, green down: a pixel says where it was taken from.
Frame ramp(int width_px, int height_px) {
  Frame frame;
  frame.sequence = 7;
  frame.width_px = width_px;
  frame.height_px = height_px;
  frame.stride_bytes = 4 * static_cast<std::size_t>(width_px) + 12;
  const auto pixels =
      std::make_shared<std::uint8_t[]>(frame.stride_bytes * static_cast<std::size_t>(height_px));
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) {
      std::uint8_t* pixel =
          pixels.get() + static_cast<std::size_t>(y) * frame.stride_bytes + 4 * static_cast<std::size_t>(x);
      pixel[0] = static_cast<std::uint8_t>(x);
      pixel[1] = static_cast<std::uint8_t>(y);
      pixel[3] = 255;
    }
  }
  frame.pixels = pixels;
  return frame;
}

TEST(Undistortion, TakesEveryPixelFromWhereTheLensSawIt) {
  Lens lens;
  lens.width_px = 200;
  lens.height_px = 160;
  lens.fx_px = 250;
  lens.fy_px = 240;
  lens.cx_px = 104;
  lens.cy_px = 77;
  lens.distortion = {-0.15, 0.05, 0.004, -0.003, 0.01};
  lens.camera_from_rig = Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()) * Eigen::Translation3d(10, 20, 30);
  const Undistortion undistortion(lens);
  const Frame straight = undistortion.apply(ramp(200, 160));
  ASSERT_EQ(straight.width_px, 200);
  EXPECT_EQ(straight.sequence, 7U);
  EXPECT_EQ(undistortion.lens().distortion.k1, 0);
  double farthest = 0;
  for (int y = 8; y < 152; y += 4) {
    for (int x = 8; x < 192; x += 4) {
      const Eigen::Vector3d point_mm =
          lens.camera_from_rig.inverse() *
          Eigen::Vector3d(700 * (x - lens.cx_px) / lens.fx_px, 700 * (y - lens.cy_px) / lens.fy_px, 700);
      ASSERT_LT((*undistortion.lens().project(point_mm) - Eigen::Vector2d(x, y)).norm(), 1e-9);
      const Eigen::Vector2d seen = *lens.project(point_mm);
      const std::uint8_t* pixel = straight.row(y) + 4 * static_cast<std::size_t>(x);
      if (seen.minCoeff() > 1 && seen.x() < 198 && seen.y() < 158) {
        EXPECT_NEAR(pixel[0], seen.x(), 0.6);
        EXPECT_NEAR(pixel[1], seen.y(), 0.6);
        farthest = std::max(farthest, (seen - Eigen::Vector2d(x, y)).norm());
      }
    }
  }
  EXPECT_GT(farthest, 1) << "there was something to undo";
}

TEST(Undistortion, AnotherLensesPictureIsNone) {
  Lens lens;
  lens.width_px = 40;
  lens.height_px = 30;
  lens.fx_px = lens.fy_px = 50;
  const Undistortion undistortion(lens);
  EXPECT_TRUE(undistortion.apply(ramp(41, 30)).empty());
  EXPECT_TRUE(undistortion.apply({}).empty());
}

}  // namespace
}  // namespace facet::capture
