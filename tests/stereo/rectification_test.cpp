#include "stereo/rectification.hpp"

#include <gtest/gtest.h>

#include "facet/error.hpp"
#include "support/stereo_scene.hpp"

namespace facet::stereo {
namespace {

const capture::Rig& rig() {
  static const capture::Rig made = test::StereoScene().rig;
  return made;
}
constexpr DepthRange kDepths{660, 840};

TEST(Rectification, SeesEveryPointInTheSameRowAtItsDisparity) {
  const Rectification pair(rig(), {0, 1}, kDepths, 640, 480);
  for (const double depth : {670.0, 750.0, 830.0}) {
    for (double y = 0; y < 480; y += 53) {
      for (double x = 0; x < 640; x += 71) {
        const Eigen::Vector3d point = pair.point_mm({x, y}, depth);
        const auto left = pair.left().project(point);
        const auto right = pair.right().project(point);
        ASSERT_TRUE(left && right);
        EXPECT_LT((*left - Eigen::Vector2d(x, y)).norm(), 1e-9);
        EXPECT_NEAR(right->y(), y, 1e-9);
        EXPECT_NEAR(right->x(), x - pair.disparity_px(depth), 1e-9);
        EXPECT_NEAR(pair.depth_mm(pair.disparity_px(depth)), depth, 1e-9);
        // The left camera's own picture shows the point where the map says.
        const auto own = rig().cameras[0].lens.project(point);
        const auto mapped = pair.left_picture_px({x, y});
        ASSERT_TRUE(own && mapped);
        EXPECT_LT((*own - *mapped).norm(), 1e-8);
      }
    }
  }
}

TEST(Rectification, MapsGoThroughTheLenses) {
  const Rectification pair(rig(), {0, 1}, kDepths, 640, 480);
  const std::vector<Eigen::Vector2f> left = pair.left_sources();
  const std::vector<Eigen::Vector2f> right = pair.right_sources();
  ASSERT_EQ(left.size(), 640U * 480U);
  int outside = 0;
  for (std::size_t at = 0; at < left.size(); at += 997) {
    const Eigen::Vector2d pixel(static_cast<double>(at % 640), static_cast<double>(at / 640));
    if (left[at].x() < 0) {
      ++outside;
      continue;
    }
    EXPECT_LT((pair.left_picture_px(pixel)->cast<float>() - left[at]).norm(), 1e-3F);
    // Any point behind a right rectified pixel lies behind the right picture's pixel.
    const Eigen::Vector3d direction((pixel.x() - pair.right().cx_px) / pair.right().fx_px,
                                    (pixel.y() - pair.right().cy_px) / pair.right().fy_px, 1);
    const auto there = rig().cameras[1].lens.project(pair.right().camera_from_rig.inverse() *
                                                     Eigen::Vector3d(direction * 800));
    if (right[at].x() >= 0) {
      ASSERT_TRUE(there);
      EXPECT_LT((there->cast<float>() - right[at]).norm(), 1e-3F);
    }
  }
  EXPECT_LT(outside, 40);
}

TEST(Rectification, MiddleOfTheDepthsIsInTheMiddleOfBothPictures) {
  const Rectification pair(rig(), {0, 1}, kDepths, 640, 480);
  EXPECT_NEAR(pair.least_disparity_px() + pair.most_disparity_px(), 0, 2);
  EXPECT_LT(pair.least_disparity_px(), 0);
  EXPECT_NEAR(pair.disparity_px(840), pair.least_disparity_px(), 1);
  EXPECT_NEAR(pair.disparity_px(660), pair.most_disparity_px(), 1);
  // What one px is worth, against the difference quotient.
  const double quotient =
      pair.depth_mm(pair.disparity_px(750) - 0.5) - pair.depth_mm(pair.disparity_px(750) + 0.5);
  EXPECT_NEAR(pair.depth_per_px_mm(750), quotient, 1e-4);
}

TEST(Rectification, RefusesPairsThatCannotBe) {
  EXPECT_THROW(Rectification(rig(), {1, 0}, kDepths, 640, 480), Error);  // swapped
  EXPECT_THROW(Rectification(rig(), {0, 7}, kDepths, 640, 480), Error);
  EXPECT_THROW(Rectification(rig(), {0, 0}, kDepths, 640, 480), Error);
  EXPECT_THROW(Rectification(rig(), {0, 1}, {840, 660}, 640, 480), Error);
  capture::Rig apart = rig();
  apart.cameras[1].lens.camera_from_rig.prerotate(Eigen::AngleAxisd(1.3, Eigen::Vector3d::UnitY()));
  EXPECT_THROW(Rectification(apart, {0, 1}, kDepths, 640, 480), Error);
}

}  // namespace
}  // namespace facet::stereo
