// The trigger on real GPIO lines of the kernel, simulated by its module gpio-sim.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <optional>
#include <string>
#include <thread>

#include "bench_of_lines.hpp"
#include "facet/error.hpp"
#include "support/simulated_chip.hpp"
#include "trigger/gpio_trigger.hpp"

namespace facet::trigger {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

/// Skipped by name where there is no gpio-sim.
class GpioSim : public ::testing::Test {
 protected:
  void SetUp() override {
    if (const std::string missing = test::SimulatedChip::missing(); !missing.empty()) {
      GTEST_SKIP() << missing;
    }
    chip_.emplace();
    ASSERT_NE(chip_->name(), "");
    const TriggerProgram program = two_cameras_two_projectors();
    for (std::size_t i = 0; i < program.lines.size(); ++i) {
      config_.outputs.push_back(
          {program.lines[i].name, chip_->name(), "facet" + std::to_string(i), LineDrive::PushPull});
    }
  }

  std::string level(int line) const { return chip_->level(line); }
  std::string complaint() const {
    try {
      open_gpio_trigger(two_cameras_two_projectors(), config_);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
      return error.what();
    }
    return "no error";
  }

  std::optional<test::SimulatedChip> chip_;
  GpioTriggerConfig config_;
};

TEST_F(GpioSim, LinesRestAtTheirSafeLevel) {
  const auto trigger = open_gpio_trigger(two_cameras_two_projectors(), config_);
  const std::vector<std::string> rest = {"0", "1", "0", "1"};  // the right camera is active low
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(level(i), rest[static_cast<std::size_t>(i)]) << "line " << i;
  }
  trigger->start(0);
  TriggerEvent event;
  while (trigger->status().slots_fired < 5 && trigger->next(event, 60s)) {
  }
  trigger->stop();
  EXPECT_EQ(trigger->status().state, TriggerState::Idle);
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(level(i), rest[static_cast<std::size_t>(i)]) << "line " << i;
  }
}

TEST_F(GpioSim, ALineThatIsHeldIsNamedWithItsHolder) {
  config_.consumer = "another program";
  const auto holder = open_gpio_trigger(two_cameras_two_projectors(), config_);
  EXPECT_THAT(complaint(), ::testing::AllOf(HasSubstr("'camera.left'"), HasSubstr(chip_->name()),
                                            HasSubstr("facet0"), HasSubstr("is held by 'another program'")));
}

TEST_F(GpioSim, AnUnknownLineIsNamedWithThoseThatAre) {
  config_.outputs[1].line = "facet9";
  EXPECT_THAT(complaint(), ::testing::AllOf(HasSubstr("no line 'facet9'"), HasSubstr("facet0, facet1")));
  config_.outputs[1].line = "1";
  EXPECT_EQ(complaint(), "no error") << "an offset";
}

/// A thread is the wire from the left camera's line to an input.
TEST_F(GpioSim, ReadBackProvesEdges) {
  config_.read_backs = {{"camera.left", chip_->name(), "facet7", false}};
  TriggerProgram program = two_cameras_two_projectors();
  program.slots_per_second = 10;
  program.exposure_ns = 50 * kMillisecond;
  program.lines[0].pulse_ns = 0;
  const auto trigger = open_gpio_trigger(program, config_);
  std::atomic<bool> cut = false;
  std::thread wire([&] {
    while (!cut) {
      chip_->pull(7, level(0) == "1" ? "pull-up" : "pull-down");
    }
  });
  trigger->start(0);
  TriggerEvent event;
  bool seen = false;
  while (!seen && trigger->next(event, 60s)) {
    seen = event.kind == TriggerEvent::Kind::Seen;
  }
  trigger->stop();
  cut = true;
  wire.join();
  EXPECT_TRUE(seen);
  const TriggerStatus status = trigger->status();
  EXPECT_EQ(status.edges_proven + status.edges_missing, 2 * status.slots_fired);
}

}  // namespace
}  // namespace facet::trigger
