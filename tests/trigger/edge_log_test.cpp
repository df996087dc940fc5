#include "trigger/edge_log.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "bench_of_lines.hpp"
#include "facet/error.hpp"

namespace facet::trigger {
namespace {

using ::testing::HasSubstr;

TEST(EdgeLog, KeepsWhatARunDid) {
  const TriggerProgram program = two_cameras_two_projectors();
  BenchOfLines bench(program);
  bench.proven_lines = 0b0011;
  bench.stalls = {{bench.time_ns + 45 * kMillisecond, 20 * kMillisecond}};
  ASSERT_TRUE(bench.run(program, 10));
  const std::string text = to_text({program.lines, bench.events});
  const EdgeLog read = parse_edge_log(text, "log");
  ASSERT_EQ(read.lines.size(), 4U);
  EXPECT_EQ(read.lines[3].name, "projector.b");
  EXPECT_EQ(read.lines[3].role, LineRole::Projector);
  EXPECT_TRUE(read.lines[3].safe_active);
  ASSERT_EQ(read.events.size(), bench.events.size());
  EXPECT_EQ(to_text(read), text);
}

std::string complaint(const std::string& text) {
  try {
    parse_edge_log(text, "log");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return "no error";
}

TEST(EdgeLog, SaysWhereItIsBroken) {
  const std::string begin = "facet-edges 1\nline a camera 0\n";
  EXPECT_EQ(complaint(begin + "edge 0 1 5 1 100 101 1"), "no error");
  EXPECT_THAT(complaint("edges"), HasSubstr("log:1: is no edge log"));
  EXPECT_THAT(complaint(begin), HasSubstr("holds no event"));
  EXPECT_THAT(complaint(""), HasSubstr("holds no event"));
  EXPECT_THAT(complaint(begin + "edge 1 1 5 1 100 101 1"), HasSubstr("log:3: '1' is no number from 0 to 0"));
  EXPECT_THAT(complaint(begin + "edge 0 1 5 1 100 101"), HasSubstr("log:3: the line is too short"));
  EXPECT_THAT(complaint(begin + "edge 0 1 5 1 100 101 1 9"), HasSubstr("too long"));
  EXPECT_THAT(complaint(begin + "edge 0 1 5 1 -100 101 1"), HasSubstr("'-100'"));
  EXPECT_THAT(complaint(begin + "edge 0 1 5 1 1e3 101 1"), HasSubstr("'1e3'"));
  EXPECT_THAT(complaint(begin + "egde 0 1 5 1 100 101 1"), HasSubstr("none of edge, seen"));
  EXPECT_THAT(complaint("facet-edges 1\nedge 0 1 5 1 100 101 1"), HasSubstr("follow the lines"));
}

}  // namespace
}  // namespace facet::trigger
