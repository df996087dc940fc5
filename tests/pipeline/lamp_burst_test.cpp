#include "pipeline/lamp_burst.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "support/lamp_lines.hpp"
#include "support/simulated_chip.hpp"

namespace facet::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

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

/// Lamps on lines of the kernel's; skipped by name where there is no gpio-sim.
class LampsOnGpioSim : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const std::string missing = test::SimulatedChip::missing(); !missing.empty()) {
      GTEST_SKIP() << missing;
    }
    chip_.emplace();
    ASSERT_NE(chip_->name(), "");
    config_.outputs = {{"left", chip_->name(), "facet2", trigger::LineDrive::PushPull},
                       {"right", chip_->name(), "facet5", trigger::LineDrive::PushPull}};
    config_.each_ms = 100;
  }
  std::string levels() const { return chip_->level(2) + chip_->level(5); }

  std::optional<test::SimulatedChip> chip_;
  LampsConfig config_;
};

TEST_F(LampsOnGpioSim, EachIsOnByItselfAndAllAreOffAtTheEnd) {
  for (const bool active_low : {false, true}) {
    config_.active_low = active_low;
    const std::vector<std::string> wanted =
        active_low ? std::vector<std::string>{"11", "01", "10", "11", "01", "11"}
                   : std::vector<std::string>{"00", "10", "01", "00", "10", "00"};
    std::vector<std::string> was;
    {
      const auto lamps = open_lamps(config_);
      was.push_back(levels());
      lamps->begin(0);
      was.push_back(levels());
      EXPECT_TRUE(lamps->go_on(120 * kMillisecond_ns));
      was.push_back(levels());
      EXPECT_TRUE(lamps->go_on(220 * kMillisecond_ns));
      was.push_back(levels());
      EXPECT_FALSE(lamps->go_on(320 * kMillisecond_ns));
      lamps->begin(0);
      was.push_back(levels());
      lamps->end();
      was.push_back(levels());
    }
    EXPECT_EQ(was, wanted) << "active low: " << active_low;
  }
}

TEST_F(LampsOnGpioSim, EndsWithoutPictures) {
  const auto lamps = open_lamps(config_);
  lamps->begin(0);
  EXPECT_EQ(levels(), "10");
  while (lamps->is_on()) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_EQ(levels(), "00");
}

TEST_F(LampsOnGpioSim, ALineThatIsHeldIsNamedWithItsHolder) {
  const auto holder = open_lamps(config_);
  try {
    open_lamps(config_);
    ADD_FAILURE() << "taken twice";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
    EXPECT_THAT(error.what(), AllOf(HasSubstr("'left'"), HasSubstr(chip_->name()), HasSubstr("facet2"),
                                    HasSubstr("is held by 'facet lamps'")));
  }
}

}  // namespace
}  // namespace facet::pipeline
