#include "track/depth_filter.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace facet::track {
namespace {

constexpr double kSeconds = 1 / 30.0;

double second_difference(const std::vector<double>& values) {
  double sum = 0;
  for (std::size_t t = 2; t < values.size(); ++t) {
    sum += std::abs(values[t] - 2 * values[t - 1] + values[t - 2]);
  }
  return sum / static_cast<double>(values.size() - 2);
}

TEST(DepthFilter, CalmsAStillHead) {
  std::mt19937 random(1);
  std::normal_distribution<double> noise(600, 0.05);
  DepthFilter filter;
  std::vector<double> raw;
  std::vector<double> calmed;
  for (int t = 0; t < 300; ++t) {
    raw.push_back(noise(random));
    calmed.push_back(filter.apply(raw.back(), kSeconds));
  }
  EXPECT_LT(second_difference(calmed), 0.35 * second_difference(raw));
  EXPECT_NEAR(calmed.back(), 600, 0.1);
}

TEST(DepthFilter, StaysCloseBehindAHeadThatMoves) {
  // Starts, comes nearer by 400 mm a second, and stops.
  DepthFilter filter;
  double depth_mm = 800;
  for (int t = 0; t < 90; ++t) {
    depth_mm -= t >= 30 && t < 60 ? 400 * kSeconds : 0;
    const double lag_mm = filter.apply(depth_mm, kSeconds) - depth_mm;
    EXPECT_LT(std::abs(lag_mm), t == 30 ? 10 : t < 34 ? 6 : 1.5) << t;
  }
}

TEST(DepthFilter, PassesTheFirstDistance) {
  DepthFilter filter;
  EXPECT_EQ(filter.apply(500, kSeconds), 500);
  EXPECT_NE(filter.apply(510, kSeconds), 510);
  filter.reset();
  EXPECT_EQ(filter.apply(700, kSeconds), 700);
}

}  // namespace
}  // namespace facet::track
