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
    const Performance performance(seed, 10);
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
    const Performance performance(seed, 5);
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
    const Performance performance(seed, 20);
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

TEST(Performance, IsAFunctionOfTheSeed) {
  const Performance one(4, 5);
  const Performance same(4, 5);
  const Performance other(5, 5);
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

}  // namespace
}  // namespace facet::simulation
