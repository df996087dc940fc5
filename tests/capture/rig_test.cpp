#include "capture/rig.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "facet/error.hpp"

namespace {

using facet::capture::Lens;

Lens wide_lens() {
  Lens lens;
  lens.width_px = 640;
  lens.height_px = 480;
  lens.fx_px = 520;
  lens.fy_px = 523;
  lens.cx_px = 321.5;
  lens.cy_px = 237.25;
  lens.distortion = {-0.28, 0.09, 0.0007, -0.0011, -0.012};
  lens.camera_from_rig =
      Eigen::Translation3d(-30, 12, 800) * Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitY());
  return lens;
}

TEST(Lens, DirectionUndoesProjection) {
  const Lens lens = wide_lens();
  for (double y = 0; y <= 479; y += 47.9) {
    for (double x = 0; x <= 639; x += 63.9) {
      const auto direction = lens.direction({x, y});
      ASSERT_TRUE(direction) << x << ", " << y;
      const Eigen::Vector3d point = lens.camera_from_rig.inverse() * Eigen::Vector3d(*direction * 750);
      const auto pixel = lens.project(point);
      ASSERT_TRUE(pixel);
      EXPECT_LT((*pixel - Eigen::Vector2d(x, y)).norm(), 1e-8) << x << ", " << y;
    }
  }
}

TEST(Lens, ProjectionFollowsBrownsModel) {
  Lens lens = wide_lens();
  lens.camera_from_rig.setIdentity();
  const auto pixel = lens.project({120, -90, 400});
  ASSERT_TRUE(pixel);
  const double x = 0.3;
  const double y = -0.225;
  const double r2 = x * x + y * y;
  const double radial = 1 - 0.28 * r2 + 0.09 * r2 * r2 - 0.012 * r2 * r2 * r2;
  EXPECT_NEAR(pixel->x(), 520 * (x * radial + 2 * 0.0007 * x * y - 0.0011 * (r2 + 2 * x * x)) + 321.5, 1e-9);
  EXPECT_NEAR(pixel->y(), 523 * (y * radial + 0.0007 * (r2 + 2 * y * y) - 2 * 0.0011 * x * y) + 237.25, 1e-9);
}

TEST(Lens, NothingIsSeenBehindIt) {
  Lens lens = wide_lens();
  EXPECT_FALSE(lens.project(lens.camera_from_rig.inverse() * Eigen::Vector3d(0, 0, -10)));
  EXPECT_FALSE(lens.project(lens.centre_mm()));
}

TEST(Lens, WhereTheModelTurnsBackThereIsNoDirection) {
  Lens lens = wide_lens();
  lens.distortion = {-0.5, 0, 0, 0, 0};  // no point is seen beyond 0.54 of the focal length
  EXPECT_TRUE(lens.direction({lens.cx_px + 0.5 * lens.fx_px, lens.cy_px}));
  EXPECT_FALSE(lens.direction({lens.cx_px + 0.6 * lens.fx_px, lens.cy_px}));
}

TEST(Rig, ACameraIsFoundByItsName) {
  facet::capture::Rig rig;
  rig.cameras = {{"left", {}, false}, {"right", {}, true}};
  EXPECT_EQ(facet::capture::find_camera(rig, "right"), 1U);
  EXPECT_EQ(facet::capture::find_camera(rig, "Right"), std::nullopt);
  EXPECT_EQ(&facet::capture::camera_named(rig, "rig.toml", "left", "name one"), rig.cameras.data());
  try {
    facet::capture::camera_named(rig, "rig.toml", "top", "name one");
    FAIL();
  } catch (const facet::Error& error) {
    EXPECT_EQ(error.kind(), facet::ErrorKind::Usage);
    EXPECT_STREQ(error.what(), "the rig file 'rig.toml' has no camera 'top'; it has left, right: name one");
  }
}

}  // namespace
