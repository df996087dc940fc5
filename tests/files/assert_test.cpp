#include "facet/assert.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <limits>

namespace facet {
namespace {

void expect_in_order(std::uint64_t read, std::uint64_t written) {
  FACET_ASSERT(read <= written, read, written);
}

TEST(Assert, WhatHoldsGoesOn) {
  int looked = 0;
  FACET_ASSERT(++looked == 1);
  expect_in_order(3, 3);
  EXPECT_EQ(looked, 1);
}

TEST(AssertDeathTest, WhatDoesNotHoldIsSaidWithItsNumbers) {
  EXPECT_DEATH(
      expect_in_order(5, 3),
      "^facet: fault: read <= written does not hold in expect_in_order \\(assert_test.cpp:[0-9]+\\); "
      "read, written = 5, 3\n");
  EXPECT_DEATH(FACET_ASSERT(false),
               "^facet: fault: false does not hold in TestBody \\(assert_test.cpp:[0-9]+\\)\n");
  EXPECT_DEATH(FACET_ASSERT(1 > 2, -1.5, true, std::numeric_limits<std::int64_t>::min()),
               "= -1.5, true, -9223372036854775808\n");
}

TEST(AssertDeathTest, TheJournalTakesItAsCritical) {
  EXPECT_DEATH(
      {
        ::setenv("JOURNAL_STREAM", "1:2", 1);
        expect_in_order(1, 0);
      },
      "^<2>facet: fault: read <= written");
}

}  // namespace
}  // namespace facet
