#include "maths/statistics.hpp"

#include <gtest/gtest.h>

#include <array>
#include <span>
#include <vector>

#include "maths/srgb.hpp"

namespace facet::maths {
namespace {

TEST(Statistics, TheMedianOfAnEvenNumberIsTheUpperOne) {
  EXPECT_EQ(median_of(std::vector{3.0, 1.0, 2.0}), 2.0);
  EXPECT_EQ(median_of(std::vector{4.0, 1.0, 2.0, 3.0}), 3.0);
  EXPECT_EQ(median_of(std::vector{7}), 7);
}

TEST(Statistics, AQuantileIsTheNearestOfTheValues) {
  std::array values{50, 10, 40, 20, 30};
  EXPECT_EQ(quantile_of(values, 0.0), 10);
  EXPECT_EQ(quantile_of(values, 0.95), 50);
  EXPECT_EQ(quantile_of(values, 0.6), 30);
  std::array first_three{3, 1, 2, 99};
  EXPECT_EQ(quantile_of(std::span(first_three).first(3), 1.0), 3);
  EXPECT_EQ(first_three[3], 99);
}

TEST(Statistics, NthIsThatOfTheSortedValues) {
  std::vector values{5.0F, 1.0F, 4.0F, 2.0F};
  EXPECT_EQ(nth_of(values, 1), 2.0F);
}

TEST(Srgb, MeetsAtItsKnees) {
  EXPECT_NEAR(decode_srgb(0.5), 0.214041, 1e-6);  // IEC 61966-2-1
  // The standard's two knees differ by so much.
  EXPECT_NEAR(encode_srgb(decode_srgb(0.04045F)), 0.04045F, 1e-7F);
  for (float value = 0; value <= 1; value += 1.0F / 64) {
    EXPECT_NEAR(encode_srgb(decode_srgb(value)), value, 2e-6F) << value;
  }
}

}  // namespace
}  // namespace facet::maths
