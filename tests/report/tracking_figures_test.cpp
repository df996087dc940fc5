#include "report/tracking_figures.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace facet::report {
namespace {

const WeightFigures& of(const std::vector<WeightFigures>& figures, const std::string& name) {
  for (const WeightFigures& one : figures) {
    if (one.name == name) {
      return one;
    }
  }
  throw std::runtime_error(name + " is not there");
}

TEST(ExpressionSum, KnownCoursesGiveKnownFigures) {
  ExpressionSum sum;
  const std::vector<std::string> names{"jawOpen", "eyeBlinkLeft", "browInnerUp", "mouthLeft",
                                       "ofTheModelAlone"};
  for (int k = 0; k < 40; ++k) {
    const float wave = k < 20 ? 0.0F : 0.5F + 0.5F * std::sin(0.4F * static_cast<float>(k));
    // The jaw follows at half the size and rests at 0.1; the left blink is turned round, the brow stays still
    // although the truth moves, the mouth moves although the truth does not.
    sum.add(
        names, {0.1F + 0.5F * wave, 1 - wave, 0.3F, wave, 1},
        {{"JawOpen", wave}, {"eyeBlink_L", wave}, {"browInnerUp", wave}, {"mouthLeft", 0.01F}, {"other", 1}});
  }
  const auto figures = sum.figures();
  ASSERT_EQ(figures.size(), 4U);
  const WeightFigures& jaw = of(figures, "jawOpen");
  EXPECT_TRUE(jaw.moves);
  EXPECT_NEAR(jaw.correlation, 1, 1e-5);
  EXPECT_NEAR(jaw.slope, 0.5, 1e-5);
  EXPECT_NEAR(jaw.rest_offset, 0.1, 1e-2);
  EXPECT_NEAR(of(figures, "eyeBlinkLeft").correlation, -1, 1e-5);
  EXPECT_NEAR(of(figures, "eyeBlinkLeft").slope, -1, 1e-5);
  const WeightFigures& brow = of(figures, "browInnerUp");
  EXPECT_TRUE(brow.is_dead);
  EXPECT_TRUE(std::isnan(brow.correlation));
  EXPECT_NEAR(brow.slope, 0, 1e-6);
  EXPECT_NEAR(brow.rest_offset, 0.3, 1e-6);
  const WeightFigures& mouth = of(figures, "mouthLeft");
  EXPECT_FALSE(mouth.moves);
  EXPECT_TRUE(std::isnan(mouth.correlation));
  EXPECT_GT(mouth.rest_offset, 0.1);

  const WeightSummary summary = summary_of(figures);
  EXPECT_EQ(summary.moving, 3);
  EXPECT_EQ(summary.well, 1);
  EXPECT_EQ(summary.fairly, 1);
  EXPECT_EQ(summary.dead, 1);
  EXPECT_NEAR(summary.median_slope, 0, 1e-5);
  EXPECT_TRUE(ExpressionSum().figures().empty());
  EXPECT_TRUE(std::isnan(summary_of({}).median_slope));
}

Eigen::Isometry3f turned(float degrees, const Eigen::Vector3f& axis, const Eigen::Vector3f& shift_mm) {
  Eigen::Isometry3f pose(Eigen::AngleAxisf(degrees * std::numbers::pi_v<float> / 180, axis.normalized()));
  pose.pretranslate(shift_mm);
  return pose;
}

TEST(PoseSum, HeadFramesMayDifferErrorsMayNot) {
  const Eigen::Isometry3f between = turned(25, {1, 2, 3}, {4, -30, 12});
  PoseSum same;
  PoseSum off;
  for (int k = 0; k < 50; ++k) {
    const auto t = static_cast<float>(k);
    const Eigen::Isometry3f truth = turned(20 * std::sin(0.3F * t), {0.2F, 1, 0}, {t, 0, 600});
    same.add_pose(truth * between, truth);
    // A turn of a degree and a shift of two millimetres in depth, this way and that.
    const float sign = k % 2 == 0 ? 1.0F : -1.0F;
    Eigen::Isometry3f wrong = truth * between * turned(sign, {0, 1, 0}, {0, 0, 0});
    wrong.pretranslate(Eigen::Vector3f(0, 0, 2 * sign));
    off.add_pose(wrong, truth);
    off.add_focal_length(1100, 1000);
  }
  EXPECT_LT(same.figures().rotation_deg, 0.02);
  EXPECT_LT(same.figures().translation_mm, 0.01);
  EXPECT_TRUE(std::isnan(same.figures().focal_percent));
  const PoseFigures figures = off.figures();
  EXPECT_EQ(figures.frames, 50);
  EXPECT_NEAR(figures.rotation_deg, 1, 0.02);
  EXPECT_NEAR(figures.depth_mm, 2, 0.05);
  EXPECT_NEAR(figures.translation_mm, 2, 0.05);
  EXPECT_NEAR(figures.translation_p95_mm, 2, 0.1);
  EXPECT_NEAR(figures.focal_percent, 10, 1e-3);
  EXPECT_EQ(PoseSum().figures().frames, 0);
  EXPECT_TRUE(std::isnan(PoseSum().figures().rotation_deg));
}

}  // namespace
}  // namespace facet::report
