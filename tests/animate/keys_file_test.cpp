// The keys file: what it may say, and what is said of one that is wrong.

#include "animate/keys_file.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "facet/error.hpp"

namespace facet::animate {
namespace {

using ::testing::HasSubstr;

std::string error_of(const std::string& text) {
  try {
    parse_keys(text, "film.json");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(), HasSubstr("film.json"));
    return error.what();
  }
  return "no error";
}

TEST(KeysFile, IsRead) {
  const KeyList list = parse_keys(R"({
      "rate_hz": 25, "beyond": true, "pace": "shortest", "regions": ["brow-left", 12],
      "keys": [{"time_s": 0.5, "frame": 17},
               {"time_s": 2, "controls": [{"vertex": 4711, "at_mm": [1, -2.5, 3e1]},
                                          {"vertex": "chin", "move_mm": [0, -5, 0]},
                                          {"vertex": 9, "at_px": [640, 360.5]}]},
               {"time_s": 3}]})",
                                  "film.json");
  EXPECT_EQ(list.rate_hz, 25);
  EXPECT_TRUE(list.beyond);
  EXPECT_FALSE(list.whole);
  EXPECT_EQ(list.pace, Pace::Shortest);
  EXPECT_EQ(list.regions, (std::vector<std::string>{"brow-left", "12"}));
  ASSERT_EQ(list.keys.size(), 3U);
  EXPECT_EQ(list.keys[0].frame, 17U);
  ASSERT_EQ(list.keys[1].controls.size(), 3U);
  EXPECT_EQ(list.keys[1].controls[0].vertex, "4711");
  EXPECT_EQ(list.keys[1].controls[0].value, Eigen::Vector3f(1, -2.5F, 30));
  EXPECT_EQ(list.keys[1].controls[1].how, KeyControl::How::Move);
  EXPECT_EQ(list.keys[1].controls[2].how, KeyControl::How::Screen);
  EXPECT_TRUE(list.keys[2].controls.empty());
}

TEST(KeysFile, TheOldSpellingOfBeyondIsRead) {
  const auto beyond = [](const std::string& flag) {
    return parse_keys("{" + flag + R"("keys": [{"time_s": 0}]})", "old.json").beyond;
  };
  EXPECT_TRUE(beyond(R"("clamp": false, )"));
  EXPECT_FALSE(beyond(R"("clamp": true, )"));
  EXPECT_FALSE(beyond(""));
  EXPECT_THAT(error_of(R"({"clamp": 1, "keys": [{"time_s": 0}]})"), HasSubstr("clamp"));
}

TEST(KeysFile, SaysWhatIsWrong) {
  const auto with_key = [](const std::string& key) { return R"({"keys": [)" + key + "]}"; };
  EXPECT_THAT(error_of(""), HasSubstr("not JSON"));
  EXPECT_THAT(error_of("{\"keys\": [}"), HasSubstr("not JSON"));
  EXPECT_THAT(error_of("[]"), HasSubstr("must be an object"));
  EXPECT_THAT(error_of("{}"), HasSubstr("has no 'keys'"));
  EXPECT_THAT(error_of(R"({"keys": []})"), HasSubstr("needs a key"));
  EXPECT_THAT(error_of(R"({"keys": {}})"), HasSubstr("must be a list"));
  EXPECT_THAT(error_of(R"({"keys": [{"time_s": 0}], "wohle": true})"),
              HasSubstr("'wohle', which is not known"));
  EXPECT_THAT(error_of(R"({"keys": [{"time_s": 0}], "whole": 1})"), HasSubstr("true or false"));
  EXPECT_THAT(error_of(R"({"keys": [{"time_s": 0}], "rate_hz": 0})"), HasSubstr("'rate_hz' is 0"));
  EXPECT_THAT(error_of(R"({"keys": [{"time_s": 0}], "pace": "slow"})"), HasSubstr("'pace'"));
  EXPECT_THAT(error_of(with_key(R"({"frame": 1})")), HasSubstr("key 1 has no 'time_s'"));
  EXPECT_THAT(error_of(with_key(R"({"time_s": -1})")), HasSubstr("key 1, 'time_s', is -1"));
  EXPECT_THAT(error_of(with_key(R"({"time_s": "1"})")), HasSubstr("must be a number"));
  EXPECT_THAT(error_of(with_key(R"({"time_s": 1e999})")), HasSubstr("JSON"));
  EXPECT_THAT(error_of(with_key(R"({"time_s": 1, "frame": -2})")), HasSubstr("number of a frame"));
  EXPECT_THAT(
      error_of(with_key(R"({"time_s": 1, "frame": 2, "controls": [{"vertex": 1, "at_px": [0, 0]}]})")),
      HasSubstr("both 'frame' and 'controls'"));
  EXPECT_THAT(error_of(with_key(R"({"time_s": 2}, {"time_s": 1})")),
              HasSubstr("key 2 is at 1 s, the one before it at 2 s"));
  EXPECT_THAT(error_of(with_key(R"({"time_s": 2}, {"time_s": 2})")), HasSubstr("time must go forward"));
  const auto with_control = [&](const std::string& control) {
    return with_key(R"({"time_s": 0, "controls": [)" + control + "]}");
  };
  EXPECT_THAT(error_of(with_control("3")), HasSubstr("key 1, control 1 must be an object"));
  EXPECT_THAT(error_of(with_control(R"({"at_mm": [0, 0, 0]})")), HasSubstr("has no 'vertex'"));
  EXPECT_THAT(error_of(with_control(R"({"vertex": 1.5, "at_mm": [0, 0, 0]})")),
              HasSubstr("number of a vertex"));
  EXPECT_THAT(error_of(with_control(R"({"vertex": 1})")), HasSubstr("needs one of"));
  EXPECT_THAT(error_of(with_control(R"({"vertex": 1, "at_mm": [0, 0, 0], "move_mm": [0, 0, 0]})")),
              HasSubstr("needs one of"));
  EXPECT_THAT(error_of(with_control(R"({"vertex": 1, "at_mm": [0, 0]})")), HasSubstr("list of 3 numbers"));
  EXPECT_THAT(error_of(with_control(R"({"vertex": 1, "at_mm": [0, 0, 1e9]})")), HasSubstr("is 1000000000"));
  EXPECT_THAT(error_of(with_control(R"({"vertex": 1, "at_mm": [0, null, 0]})")),
              HasSubstr("must be a number"));
}

TEST(KeysFile, DepthIsRefusedWhateverItsLength) {
  for (const std::size_t bytes : {100U, 20'000U, 80'000U, 1U << 20, 16U << 20}) {
    const std::string deep = std::string(bytes / 2 - 10, '[') + std::string(bytes / 2 - 10, ']');
    EXPECT_THAT(error_of("{\"keys\": " + deep + "}"), HasSubstr("nests deeper"));
  }
  EXPECT_THAT(error_of(std::string((16U << 20) + 1, ' ')), HasSubstr("more than 16777216 bytes"));
}

/// As long as a keys file can be without a name or number in it that is too long: 10,000 keys of 7 controls.
TEST(KeysFile, LongOnesAreRead) {
  std::string text = R"({"keys":[)";
  for (std::size_t i = 0; i < kMostKeys; ++i) {
    text += fmt::format(R"({}{{"time_s":{},"controls":[)", i == 0 ? "" : ",", i);
    for (int k = 0; k < 7; ++k) {
      text += fmt::format(R"({}{{"vertex":{},"at_mm":[{}.0625,-12.5,3.25]}})", k == 0 ? "" : ",", k, i);
    }
    text += "]}";
  }
  text += "]}";
  EXPECT_GT(text.size(), 3U << 20);
  const KeyList list = parse_keys(text, "film.json");
  ASSERT_EQ(list.keys.size(), kMostKeys);
  EXPECT_EQ(list.keys.back().controls.back().value, Eigen::Vector3f(9999.0625F, -12.5F, 3.25F));
}

}  // namespace
}  // namespace facet::animate
