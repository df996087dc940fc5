// Outputs and read-backs planned onto chips: what is asked of the library, and what is said where it refuses.

#include "trigger/gpio_lines.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cerrno>
#include <deque>
#include <map>
#include <string>
#include <vector>

#include "bench_of_lines.hpp"
#include "facet/error.hpp"

namespace facet::trigger {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// A chip of 8 lines, "facet0" to "facet6" and one without a name, and what was asked of it.
struct ScriptedChip {
  std::vector<std::vector<GpioWire>> requests;
  std::vector<std::vector<int>> sets;  ///< of all requests, as they came
  std::map<unsigned, std::string> holders;
  std::deque<GpioEdge> edges;  ///< that a watched line has to tell
  bool refuses_requests = false;
  bool refuses_sets = false;
};

class ChipDouble final : public GpioChip {
 public:
  explicit ChipDouble(ScriptedChip& script) : script_(script) {}

  std::string title() const override { return "gpiochip0 [double]"; }
  unsigned line_count() const override { return 8; }
  std::optional<unsigned> offset_of(const std::string& name) const override {
    return name.size() == 6 && name.starts_with("facet") && name[5] < '7' ? std::optional(name[5] - '0')
                                                                          : std::nullopt;
  }
  std::optional<GpioLineInfo> line(unsigned offset) const override {
    if (offset >= 8) {
      return std::nullopt;
    }
    const auto held = script_.holders.find(offset);
    const bool used = held != script_.holders.end();
    return GpioLineInfo{offset < 7 ? "facet" + std::to_string(offset) : "", used, used ? held->second : ""};
  }
  GpioOutputs drive(const std::string& consumer, std::span<const GpioWire> wires) override {
    if (script_.refuses_requests) {
      errno = EPERM;
      return {};
    }
    script_.requests.emplace_back(wires.begin(), wires.end());
    for (const GpioWire& wire : wires) {
      script_.holders[wire.offset] = consumer;
    }
    return [this](std::span<const int> levels) {
      script_.sets.emplace_back(levels.begin(), levels.end());
      errno = EIO;
      return !script_.refuses_sets;
    };
  }
  GpioInput watch(const std::string& /*consumer*/, unsigned /*offset*/) override {
    return [this](std::span<GpioEdge> out) {
      std::size_t count = 0;
      for (; count < out.size() && !script_.edges.empty(); script_.edges.pop_front()) {
        out[count++] = script_.edges.front();
      }
      return count;
    };
  }

 private:
  ScriptedChip& script_;
};

class GpioLinesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    for (std::size_t i = 0; i < program_.lines.size(); ++i) {
      config_.outputs.push_back(
          {program_.lines[i].name, "0", "facet" + std::to_string(i), LineDrive::PushPull});
    }
    library_.open = [this](const std::string& wanted) -> std::unique_ptr<GpioChip> {
      ++opened_;
      errno = wanted == "locked" ? EACCES : ENOENT;
      return wanted == "0" || wanted == "double" ? std::make_unique<ChipDouble>(script_) : nullptr;
    };
    library_.chip_titles = [] { return std::vector<std::string>{"gpiochip0 [double]", "gpiochip1 [other]"}; };
  }
  std::string complaint() {
    try {
      open_gpio_lines(program_, config_, library_);
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Unavailable);
      return error.what();
    }
    return "no error";
  }

  TriggerProgram program_ = two_cameras_two_projectors();
  GpioTriggerConfig config_;
  ScriptedChip script_;
  GpioLibrary library_;
  int opened_ = 0;
};

TEST_F(GpioLinesTest, LinesOfOneChipAreSetByOneCallWithTheirPolarity) {
  config_.outputs[3].chip = "double";  // the same chip by its other name
  auto lines = open_gpio_lines(program_, config_, library_);
  EXPECT_EQ(opened_, 2);
  ASSERT_EQ(script_.requests.size(), 1U);
  std::vector<int> first;
  for (const GpioWire& wire : script_.requests[0]) {
    first.push_back(wire.high ? 1 : 0);
  }
  EXPECT_THAT(first, ElementsAre(0, 1, 0, 1))
      << "at rest: the right camera is active low, projector b rests active";
  EXPECT_TRUE(lines->set(0b0011, 0b0011));
  EXPECT_TRUE(lines->set(0b1001, 0b0000));
  EXPECT_EQ(lines->last_error(), "");
  lines.reset();
  EXPECT_THAT(script_.sets,
              ElementsAre(ElementsAre(1, 0, 0, 1), ElementsAre(0, 0, 0, 0), ElementsAre(0, 1, 0, 1)));
}

TEST_F(GpioLinesTest, DrivesAreAskedForApartWhereTheLibraryCantMixThem) {
  config_.outputs[1].drive = LineDrive::OpenDrain;
  open_gpio_lines(program_, config_, library_);
  EXPECT_EQ(script_.requests.size(), 2U);
  EXPECT_EQ(script_.sets.size(), 2U) << "back to the safe level";
  script_ = {};
  library_.mixes_drives = true;
  open_gpio_lines(program_, config_, library_);
  ASSERT_EQ(script_.requests.size(), 1U);
  EXPECT_EQ(script_.requests[0][1].drive, LineDrive::OpenDrain);
  EXPECT_EQ(script_.sets.size(), 1U);
}

TEST_F(GpioLinesTest, OnlyRequestsThatHoldAChangedLineAreSet) {
  config_.outputs[1].drive = LineDrive::OpenDrain;
  const auto lines = open_gpio_lines(program_, config_, library_);
  EXPECT_TRUE(lines->set(0b0010, 0b0010));
  EXPECT_THAT(script_.sets, ElementsAre(ElementsAre(0)));
}

TEST_F(GpioLinesTest, ALineThatCantBeSetIsNamed) {
  const auto lines = open_gpio_lines(program_, config_, library_);
  script_.refuses_sets = true;
  EXPECT_FALSE(lines->set(1, 1));
  EXPECT_THAT(lines->last_error(), HasSubstr("'camera.left' and others of GPIO chip gpiochip0 [double]"));
}

TEST_F(GpioLinesTest, ReadBacksTellActiveEdgesUntilThereIsNoRoom) {
  config_.read_backs = {{"camera.right", "0", "facet6", true}};
  const auto lines = open_gpio_lines(program_, config_, library_);
  EXPECT_EQ(lines->read_back(), 0b0010U);
  for (int i = 0; i < 40; ++i) {
    script_.edges.push_back({i % 2 == 0, i});
  }
  std::array<SeenEdge, 36> seen;
  ASSERT_EQ(lines->seen(seen), 36U);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    EXPECT_EQ(seen[i].line, 1);
    EXPECT_EQ(seen[i].active, i % 2 != 0) << "the input is low while the line is active";
    EXPECT_EQ(seen[i].time_ns, static_cast<std::int64_t>(i));
  }
  EXPECT_EQ(lines->seen(seen), 4U);
  EXPECT_EQ(lines->seen(seen), 0U);
}

TEST_F(GpioLinesTest, RefusalsNameChipLineAndHolder) {
  config_.outputs[2].line = "facet9";
  EXPECT_THAT(complaint(),
              HasSubstr("GPIO chip gpiochip0 [double]: no line 'facet9'; it has 8 lines, named facet0, "
                        "facet1, facet2, facet3, facet4, facet5, facet6"));
  config_.outputs[2].line = "8";
  EXPECT_THAT(complaint(), HasSubstr("no line '8'"));
  config_.outputs[2].line = "7";
  script_.holders[7] = "another program";
  EXPECT_THAT(complaint(),
              HasSubstr("trigger line 'projector.a': GPIO chip gpiochip0 [double], line 7 (unnamed) is "
                        "held by 'another program'"));
  script_.holders[7] = "";
  EXPECT_THAT(complaint(), HasSubstr("is held by 'the kernel'"));
  script_.holders.clear();
  script_.refuses_requests = true;
  EXPECT_THAT(complaint(),
              HasSubstr("trigger line 'camera.left': GPIO chip gpiochip0 [double], line 0 (facet0): "
                        "Operation not permitted"));
  script_.refuses_requests = false;
  config_.read_backs = {{"camera.left", "0", "facet3", false}};
  EXPECT_THAT(complaint(), HasSubstr("line 3 (facet3) is held by 'facet'"));
}

TEST_F(GpioLinesTest, ChipsThatCantBeOpenedAreNamedWithThoseThatAre) {
  config_.outputs[0].chip = "locked";
  EXPECT_THAT(complaint(), HasSubstr("GPIO chip 'locked': Permission denied (its device is for a group"));
  config_.outputs[0].chip = "9";
  EXPECT_THAT(complaint(),
              HasSubstr("GPIO chip '9': No such file or directory; this machine shows gpiochip0 [double], "
                        "gpiochip1 [other]"));
  library_.chip_titles = [] { return std::vector<std::string>{}; };
  EXPECT_THAT(complaint(), HasSubstr("this machine shows no GPIO chip"));
  EXPECT_THAT(script_.sets, IsEmpty());
}

}  // namespace
}  // namespace facet::trigger
