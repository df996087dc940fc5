#include "capture/patterns.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <numbers>
#include <vector>

#include "facet/error.hpp"

namespace facet::capture {
namespace {

Shown stripes(std::uint64_t number) {
  return {Shown::Kind::Stripes, number};
}

/// The projector's light, row by row.
std::vector<double> light_of(const GreyImage& image, float gamma) {
  std::vector<double> light;
  for (const std::uint8_t value : image.values) {
    light.push_back(std::pow(value / 255.0, static_cast<double>(gamma)));
  }
  return light;
}

double correlation(const std::vector<double>& a, const std::vector<double>& b) {
  double mean_a = 0;
  double mean_b = 0;
  for (std::size_t k = 0; k < a.size(); ++k) {
    mean_a += a[k] / static_cast<double>(a.size());
    mean_b += b[k] / static_cast<double>(b.size());
  }
  double ab = 0;
  double aa = 0;
  double bb = 0;
  for (std::size_t k = 0; k < a.size(); ++k) {
    ab += (a[k] - mean_a) * (b[k] - mean_b);
    aa += (a[k] - mean_a) * (a[k] - mean_a);
    bb += (b[k] - mean_b) * (b[k] - mean_b);
  }
  return ab / std::sqrt(aa * bb);
}

TEST(Patterns, FollowFromSeedNumberAndProjectorAlone) {
  PatternConfig config;
  const GreyImage first = draw_pattern(config, stripes(4));
  draw_pattern(config, stripes(9));
  EXPECT_EQ(draw_pattern(config, stripes(4)).values, first.values);

  const std::vector<double> light = light_of(first, config.gamma);
  EXPECT_LT(std::abs(correlation(light, light_of(draw_pattern(config, stripes(5)), config.gamma))), 0.3);
  EXPECT_LT(std::abs(correlation(light, light_of(draw_pattern(config, stripes(4), 1), config.gamma))), 0.3);
  config.seed = 2;
  EXPECT_LT(std::abs(correlation(light, light_of(draw_pattern(config, stripes(4)), config.gamma))), 0.3);
}

TEST(Patterns, FringesAddUpToBlankLightAndTellWhereTheyAre) {
  PatternConfig config;
  config.width_px = 256;
  config.height_px = 96;
  const auto fringes = [&](std::uint64_t quarters, std::size_t projector = 0) {
    return light_of(draw_pattern(config, {Shown::Kind::Fringes, quarters}, projector), config.gamma);
  };
  const std::vector<std::vector<double>> shifted{fringes(0), fringes(1), fringes(2), fringes(3)};
  const std::vector<double> blank = light_of(draw_pattern(config, {Shown::Kind::Blank, 0}), config.gamma);
  std::vector<double> phase;
  for (std::size_t at = 0; at < blank.size(); ++at) {
    const double sine = shifted[3][at] - shifted[1][at];
    const double cosine = shifted[0][at] - shifted[2][at];
    EXPECT_NEAR(shifted[0][at] + shifted[1][at] + shifted[2][at] + shifted[3][at], 4 * blank[at], 0.03);
    EXPECT_NEAR(std::hypot(sine, cosine), 1, 0.03);
    phase.push_back(std::atan2(sine, cosine));
  }
  // It rises everywhere, by a period in fringe_px on the whole; a period further on it is another one.
  double risen = 0;
  double unlike = 0;
  for (std::size_t row = 0; row < 96; row += 5) {
    for (std::size_t x = 0; x + 1 < 256; ++x) {
      const std::size_t at = row * 256 + x;
      const double rise = std::remainder(phase[at + 1] - phase[at], 2 * std::numbers::pi);
      EXPECT_GT(rise, 0);
      risen += rise / (20 * 255);
      if (x + 17 < 256) {
        unlike += std::abs(std::remainder(phase[at + 16] - phase[at], 2 * std::numbers::pi)) / (20 * 239);
      }
    }
  }
  EXPECT_NEAR(risen, 2 * std::numbers::pi / 16, 0.01);
  EXPECT_GT(unlike, 0.4);
  config.fringe_px = 7;
  EXPECT_THROW(draw_pattern(config, {Shown::Kind::Fringes, 0}), Error);
}

TEST(Patterns, AreUprightStripesOverTheWholeRangeOfLight) {
  const PatternConfig config;
  for (std::uint64_t number = 0; number < 6; ++number) {
    const GreyImage image = draw_pattern(config, stripes(number));
    ASSERT_EQ(image.values.size(), 1024U * 768U);
    const std::vector<double> light = light_of(image, config.gamma);
    double mean = 0;
    double square = 0;
    double across = 0;
    double down = 0;
    int turns = 0;  // of a row's light, from falling to rising or back
    double before = 0;
    for (int y = 0; y < 767; ++y) {
      for (int x = 0; x < 1023; ++x) {
        const auto at = static_cast<std::size_t>(y) * 1024 + static_cast<std::size_t>(x);
        mean += light[at];
        square += light[at] * light[at];
        across += std::abs(light[at + 1] - light[at]);
        down += std::abs(light[at + 1024] - light[at]);
        if (y == 300 && std::abs(light[at + 1] - light[at]) > 0.02) {
          turns += before != 0 && (light[at + 1] > light[at]) != (before > 0) ? 1 : 0;
          before = light[at + 1] - light[at];
        }
      }
    }
    const double count = 767.0 * 1023.0;
    mean /= count;
    EXPECT_NEAR(mean, 0.5, 0.08) << number;
    EXPECT_GT(std::sqrt(square / count - mean * mean), 0.25) << number;
    EXPECT_LT(down, 0.2 * across) << number;
    // 171 stripes of 6 px; two in three end a rise or a fall.
    EXPECT_GT(turns, 75) << number;
    EXPECT_LT(turns, 160) << number;
  }
}

TEST(Patterns, HoldNothingFinerThanTheProjector) {
  const PatternConfig config;
  for (std::uint64_t number = 0; number < 4; ++number) {
    const std::vector<double> light = light_of(draw_pattern(config, stripes(number)), config.gamma);
    // The spectrum of one row under a Hann window.
    constexpr int kCount = 1024;
    double low = 0;
    double high = 0;
    for (int bin = 3; bin <= kCount / 2; ++bin) {
      std::complex<double> sum = 0;
      for (int x = 0; x < kCount; ++x) {
        const double window = 0.5 - 0.5 * std::cos(2 * std::numbers::pi * (x + 0.5) / kCount);
        sum += window * (light[static_cast<std::size_t>(200 * kCount + x)] - 0.5) *
               std::polar(1.0, -2 * std::numbers::pi * bin * x / kCount);
      }
      (bin < 0.4 * kCount ? low : high) += std::norm(sum);
    }
    EXPECT_LT(high, 1e-3 * low) << number;  // hard edges would have some 2 % there
  }
}

TEST(Patterns, BlankIsEvenAndDarkIsBlack) {
  PatternConfig config;
  config.gamma = 1;
  for (const std::uint8_t value : draw_pattern(config, {Shown::Kind::Blank, 0}).values) {
    ASSERT_EQ(value, 128);
  }
  for (const std::uint8_t value : draw_pattern(config, {}).values) {
    ASSERT_EQ(value, 0);
  }
}

TEST(Patterns, WhatCantBeShownIsRefused) {
  const auto refused = [](int width_px, int height_px, float stripe_px, float gamma) {
    const PatternConfig config{1, width_px, height_px, stripe_px, gamma};
    EXPECT_THROW(draw_pattern(config, stripes(0)), Error);
  };
  refused(15, 768, 6, 2.2F);
  refused(1024, 9000, 6, 2.2F);
  refused(1024, 768, 2.9F, 2.2F);
  refused(1024, 768, 1025, 2.2F);
  refused(1024, 768, 6, 0.5F);
}

}  // namespace
}  // namespace facet::capture
