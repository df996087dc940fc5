#include "pipeline/lamp_burst.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <thread>
#include <utility>
#include <vector>

#include "support/lamp_lines.hpp"

namespace facet::pipeline {
namespace {

constexpr std::int64_t kMillisecond_ns = 1'000'000;

TEST(LampBurst, LampsAreOnOneAfterTheOtherThenNone) {
  std::vector<LineMask> was;
  std::atomic<LineMask> on = 9;
  auto lines = std::make_unique<test::LampLines>(on);
  LampBurst burst(std::move(lines), 3, 100);
  EXPECT_DOUBLE_EQ(burst.duration_s(), 0.4);
  EXPECT_FALSE(burst.go_on(0)) << "nobody asked for it";
  const std::int64_t began_ns = 7'000 * kMillisecond_ns;
  burst.begin(began_ns);
  was.push_back(on);
  for (int picture = 1; picture < 13; ++picture) {
    const bool goes_on = burst.go_on(began_ns + picture * 33 * kMillisecond_ns);
    EXPECT_EQ(goes_on, burst.is_on());
    EXPECT_EQ(goes_on, picture * 33 < 400) << picture;
    was.push_back(on);
  }
  EXPECT_EQ(was, (std::vector<LineMask>{1, 1, 1, 1, 2, 2, 2, 4, 4, 4, 0, 0, 0}));
  burst.begin(began_ns);
  EXPECT_EQ(on.load(), 1U) << "once more";
  burst.end();
  EXPECT_EQ(on.load(), 0U);
  EXPECT_FALSE(burst.go_on(began_ns));
}

/// Pictures that come late, or whose time goes back.
TEST(LampBurst, EndsWhateverTheTime) {
  std::atomic<LineMask> on = 0;
  LampBurst burst(std::make_unique<test::LampLines>(on), 2, 100);
  burst.begin(1'000 * kMillisecond_ns);
  EXPECT_TRUE(burst.go_on(0));
  EXPECT_EQ(on.load(), 1U);
  EXPECT_FALSE(burst.go_on(90'000 * kMillisecond_ns));
  EXPECT_EQ(on.load(), 0U);
}

/// A camera that was pulled out, a pipeline that ended: somebody else puts them out.
TEST(LampBurst, EndsWithoutPictures) {
  std::atomic<LineMask> on = 0;
  LampBurst burst(std::make_unique<test::LampLines>(on), 2, 100);
  burst.begin(0);
  EXPECT_EQ(on.load(), 1U);
  while (burst.is_on()) {  // a second and a third
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_EQ(on.load(), 0U);
  EXPECT_EQ(burst.fault(), "no picture came for their end");
  EXPECT_FALSE(burst.go_on(0));
  burst.begin(0);
  EXPECT_EQ(burst.fault(), "");
  EXPECT_TRUE(burst.go_on(0));
}

TEST(LampBurst, ALineThatFailsEndsItWithTheReason) {
  std::atomic<LineMask> on = 0;
  auto lines = std::make_unique<test::LampLines>(on);
  test::LampLines& wires = *lines;
  LampBurst burst(std::move(lines), 2, 100);
  burst.begin(0);
  EXPECT_EQ(burst.fault(), "");
  wires.fails = true;
  EXPECT_FALSE(burst.go_on(100 * kMillisecond_ns));
  EXPECT_EQ(burst.fault(), "they may still be on: line 1 was pulled out");
  wires.fails = false;
  burst.begin(0);
  EXPECT_EQ(burst.fault(), "");
}

TEST(LampBurst, WithoutLinesThereIsNone) {
  EXPECT_EQ(open_lamps({}), nullptr);
}

}  // namespace
}  // namespace facet::pipeline
