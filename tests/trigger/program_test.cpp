#include "trigger/program.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

#include "bench_of_lines.hpp"
#include "facet/error.hpp"

namespace facet::trigger {
namespace {

using ::testing::HasSubstr;

std::string complaint(const std::function<void(TriggerProgram&)>& spoil) {
  TriggerProgram program = two_cameras_two_projectors();
  spoil(program);
  try {
    check(program);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "";
}

TEST(TriggerProgramCheck, SaysWhatMustChange) {
  EXPECT_EQ(complaint([](auto&) {}), "");
  EXPECT_THAT(complaint([](auto& p) { p.lines.clear(); }), HasSubstr("1 to 64 lines"));
  EXPECT_THAT(complaint([](auto& p) { p.lines.resize(65, {.name = "x"}); }), HasSubstr("has 65"));
  EXPECT_THAT(complaint([](auto& p) { p.slots_per_second = 0; }), HasSubstr("slots per second"));
  EXPECT_THAT(complaint([](auto& p) { p.exposure_ns = 0; }), HasSubstr("must not be 0"));
  EXPECT_THAT(complaint([](auto& p) { p.settle_ns = -1; }), HasSubstr("between 0 and a slot (10000 us)"));
  EXPECT_THAT(complaint([](auto& p) { p.settle_ns = 5 * kMillisecond; }),
              HasSubstr("do not fit into a slot"));
  EXPECT_THAT(complaint([](auto& p) { p.lines[0].pulse_ns = 6 * kMillisecond; }), HasSubstr("6000 us"));
  EXPECT_THAT(complaint([](auto& p) { p.lines[2].pulse_ns = 1; }), HasSubstr("has no pulse"));
  EXPECT_THAT(complaint([](auto& p) { p.lines[0].safe_active = true; }), HasSubstr("can't rest active"));
  EXPECT_THAT(complaint([](auto& p) { p.lines[0].name = "a b"; }), HasSubstr("'a b' is no line name"));
  EXPECT_THAT(complaint([](auto& p) { p.lines[1].name = "camera.left"; }), HasSubstr("two lines"));
  EXPECT_THAT(complaint([](auto& p) { p.lines.erase(p.lines.begin(), p.lines.begin() + 2); }),
              HasSubstr("no camera line"));
  EXPECT_THAT(complaint([](auto& p) { p.patterns.clear(); }), HasSubstr("no pattern"));
  EXPECT_THAT(complaint([](auto& p) { p.patterns[1] = 1; }), HasSubstr("pattern 1"));
}

}  // namespace
}  // namespace facet::trigger
