#include "landmark/landmark_filter.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace facet::landmark {
namespace {

constexpr float interocular_px = 100;
constexpr float seconds = 1 / 30.0F;
constexpr int points = 468;

/// Points at `position_px` along x, with noise of 0.1 px.
Eigen::Matrix3Xf noisy(float position_px, std::mt19937& random) {
  std::normal_distribution<float> noise(0, 0.1F);
  return Eigen::Matrix3Xf::NullaryExpr(3, points, [&](Eigen::Index row, Eigen::Index) {
    return (row == 0 ? position_px : 50.0F) + noise(random);
  });
}

TEST(LandmarkFilter, PassesTheFirstFrame) {
  std::mt19937 random(1);
  LandmarkFilter filter;
  for (int round = 0; round < 2; ++round) {
    Eigen::Matrix3Xf frame = noisy(10, random);
    const Eigen::Matrix3Xf given = frame;
    filter.apply(interocular_px, seconds, frame);
    EXPECT_EQ(frame, given);
    filter.reset();
  }
}

TEST(LandmarkFilter, CalmsRestingPoints) {
  std::mt19937 random(1);
  LandmarkFilter filter;
  double raw = 0;
  double calmed = 0;
  for (int t = 0; t < 200; ++t) {
    Eigen::Matrix3Xf frame = noisy(200, random);
    const Eigen::RowVectorXf given = frame.row(0);
    filter.apply(interocular_px, seconds, frame);
    if (t >= 20) {
      raw += (given.array() - 200).square().mean();
      calmed += (frame.row(0).array() - 200).square().mean();
    }
  }
  EXPECT_LT(std::sqrt(calmed), 0.75 * std::sqrt(raw));
}

TEST(LandmarkFilter, DoesNotLagBehindMovingPoints) {
  // A head that starts, moves at two interocular distances a second, and stops.
  std::mt19937 random(1);
  LandmarkFilter filter;
  constexpr float step_px = 2 * interocular_px * seconds;
  float position = 0;
  for (int t = 0; t < 90; ++t) {
    const bool moving = t >= 30 && t < 60;
    position += moving ? step_px : 0;
    Eigen::Matrix3Xf frame = noisy(position, random);
    filter.apply(interocular_px, seconds, frame);
    const float lag_frames = (position - frame.row(0).mean()) / step_px;
    if (t > 32 && t < 60) {
      EXPECT_LT(std::abs(lag_frames), 0.05F) << t;
    } else if (t == 30) {
      EXPECT_LT(lag_frames, 0.2F);
    }
  }
}

TEST(LandmarkFilter, ComesToRestOnAStillImage) {
  std::mt19937 random(1);
  LandmarkFilter filter;
  Eigen::Matrix3Xf frame = noisy(200, random);
  filter.apply(interocular_px, seconds, frame);
  const Eigen::Matrix3Xf still = noisy(205, random);
  for (int t = 0; t < 100; ++t) {
    frame = still;
    filter.apply(interocular_px, seconds, frame);
  }
  EXPECT_LT((frame - still).cwiseAbs().maxCoeff(), 1e-3F);
}

}  // namespace
}  // namespace facet::landmark
