#include "simulation/performance.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

const std::vector<std::string> kNames{"jawOpen",      "mouthSmileLeft", "mouthSmileRight", "browInnerUp",
                                      "eyeBlinkLeft", "eyeBlinkRight",  "mouthPucker",     "unknownShape"};

TEST(Performance, WeightsStayInRangeAndMoveSmoothly) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const Performance performance({.seed = seed, .duration_s = 10});
    auto last = performance.expression(0, kNames);
    for (int frame = 1; frame < 330; ++frame) {
      const auto weights = performance.expression(frame / 30.0, kNames);
      for (std::size_t k = 0; k < kNames.size(); ++k) {
        EXPECT_GE(weights[k], 0);
        EXPECT_LE(weights[k], 1);
        const bool blink = kNames[k].starts_with("eyeBlink");
        EXPECT_LT(std::abs(weights[k] - last[k]), blink ? 0.8F : 0.35F)
            << seed << ' ' << frame << ' ' << kNames[k];
      }
      EXPECT_EQ(weights.back(), 0);
      last = weights;
    }
  }
}

TEST(Performance, ActsEarly) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const Performance performance({.seed = seed, .duration_s = 5});
    std::vector<float> largest(kNames.size(), 0);
    for (int frame = 0; frame < 120; ++frame) {
      const auto weights = performance.expression(frame / 30.0, kNames);
      for (std::size_t k = 0; k < kNames.size(); ++k) {
        largest[k] = std::max(largest[k], weights[k]);
      }
      if (frame < 15) {  // the start is near rest
        EXPECT_LT(weights[1], 0.2F) << seed;
        EXPECT_LT(weights[3], 0.2F) << seed;
      }
    }
    EXPECT_GT(largest[0], 0.15F) << seed;  // talks
    EXPECT_GT(largest[1], 0.5F) << seed;   // smiles
    EXPECT_GT(largest[3], 0.5F) << seed;   // raises the brows
    EXPECT_GT(largest[4], 0.9F) << seed;   // blinks
  }
}

TEST(Performance, HeadStartsFrontalAndStaysWithinItsLimits) {
  constexpr float kDegree = std::numbers::pi_v<float> / 180;
  float widest = 0;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const Performance performance({.seed = seed, .duration_s = 20});
    EXPECT_LT(std::abs(performance.head(0).yaw_rad), 6 * kDegree);
    for (int frame = 0; frame < 600; ++frame) {
      const HeadMotion motion = performance.head(frame / 30.0);
      EXPECT_LE(std::abs(motion.yaw_rad), 25.01F * kDegree);
      EXPECT_LE(std::abs(motion.pitch_rad), 25 * kDegree);
      EXPECT_LE(std::abs(motion.roll_rad), 25 * kDegree);
      widest = std::max(widest, std::abs(motion.yaw_rad));
    }
  }
  EXPECT_GT(widest, 20 * kDegree);
}

TEST(Performance, IsTheSameJustBeforeItsStart) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const Performance performance({.seed = seed});
    const Gaze before = performance.gaze(-0.02);
    const Gaze start = performance.gaze(0);
    EXPECT_NEAR(before.yaw_rad, start.yaw_rad, 0.02F) << seed;
    EXPECT_NEAR(before.pitch_rad, start.pitch_rad, 0.02F) << seed;
    EXPECT_NEAR(performance.head(-0.02).yaw_rad, performance.head(0).yaw_rad, 0.02F) << seed;
  }
}

TEST(Performance, IsAFunctionOfTheSeed) {
  const Performance one({.seed = 4, .duration_s = 5});
  const Performance same({.seed = 4, .duration_s = 5});
  const Performance other({.seed = 5, .duration_s = 5});
  EXPECT_EQ(one.expression(2.5, kNames), same.expression(2.5, kNames));
  EXPECT_EQ(one.head(2.5).yaw_rad, same.head(2.5).yaw_rad);
  EXPECT_NE(one.head(2.5).yaw_rad, other.head(2.5).yaw_rad);
}

TEST(Random, HasTheRightMoments) {
  Random random(8, 1);
  double sum = 0;
  double squares = 0;
  constexpr int kCount = 100'000;
  for (int k = 0; k < kCount; ++k) {
    const auto value = static_cast<double>(random.normal());
    sum += value;
    squares += value * value;
  }
  EXPECT_NEAR(sum / kCount, 0, 0.02);
  EXPECT_NEAR(squares / kCount, 1, 0.02);
}

TEST(Noise, IsSmoothBoundedAndBalanced) {
  const Noise noise(3, 7);
  Random random(3, 8);
  double sum = 0;
  float largest = 0;
  for (int k = 0; k < 20'000; ++k) {
    const Eigen::Vector3f at(random.uniform(-50, 50), random.uniform(-50, 50), random.uniform(-50, 50));
    const float value = noise.at(at);
    sum += static_cast<double>(value);
    largest = std::max(largest, std::abs(value));
    EXPECT_LT(std::abs(noise.at(at + Eigen::Vector3f(0.001F, 0, 0)) - value), 0.01F);
  }
  EXPECT_NEAR(sum / 20'000, 0, 0.02);
  EXPECT_GT(largest, 0.7F);
  EXPECT_LT(largest, 1.7F);
}

TEST(Performance, BeginsInTheMiddle) {
  const Performance whole({.seed = 4, .duration_s = 10});
  const Performance later({.seed = 4, .duration_s = 4, .start_s = 6});
  bool moved = false;
  for (int frame = 0; frame < 120; ++frame) {
    const auto weights = later.expression(frame / 30.0, kNames);
    moved = moved || weights[0] > 0.1F;
    EXPECT_EQ(weights, whole.expression(6 + frame / 30.0, kNames));
    EXPECT_EQ(later.head(frame / 30.0).yaw_rad, whole.head(6 + frame / 30.0).yaw_rad);
  }
  EXPECT_TRUE(moved);
}

TEST(Performance, ACalmTurnShowsBothSidesOfAFaceAtRest) {
  constexpr float kDegree = std::numbers::pi_v<float> / 180;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    const Performance turn({.seed = seed, .duration_s = kCalmTurn_s, .calm_turn = true});
    HeadMotion least;
    HeadMotion most;
    float shut = 0;
    HeadMotion last = turn.head(0);
    for (int frame = 0; frame < 300; ++frame) {
      const HeadMotion head = turn.head(frame / 30.0);
      least.yaw_rad = std::min(least.yaw_rad, head.yaw_rad);
      most.yaw_rad = std::max(most.yaw_rad, head.yaw_rad);
      least.pitch_rad = std::min(least.pitch_rad, head.pitch_rad);
      most.pitch_rad = std::max(most.pitch_rad, head.pitch_rad);
      EXPECT_LT(std::abs(head.yaw_rad - last.yaw_rad), 2 * kDegree);  // 60 degrees a second
      last = head;
      const auto weights = turn.expression(frame / 30.0, kNames);
      shut = std::max(shut, weights[4]);
      for (const std::size_t name : {0U, 1U, 2U, 3U, 6U}) {
        EXPECT_EQ(weights[name], 0) << kNames[name];
      }
    }
    EXPECT_NEAR(most.yaw_rad, 30 * kDegree, 3 * kDegree) << seed;
    EXPECT_NEAR(least.yaw_rad, -30 * kDegree, 3 * kDegree) << seed;
    EXPECT_NEAR(most.pitch_rad, 10 * kDegree, 2 * kDegree) << seed;
    EXPECT_NEAR(least.pitch_rad, -10 * kDegree, 2 * kDegree) << seed;
    EXPECT_GT(shut, 0.9F) << seed;  // blinks
  }
}

}  // namespace
}  // namespace facet::simulation
