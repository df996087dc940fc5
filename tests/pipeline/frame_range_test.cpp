#include "pipeline/frame_range.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "facet/error.hpp"

namespace facet::pipeline {
namespace {

constexpr std::uint64_t kEnd = std::numeric_limits<std::uint64_t>::max();

TEST(FrameRange, Reads) {
  EXPECT_EQ(parse_frame_range("3:7").first, 3U);
  EXPECT_EQ(parse_frame_range("3:7").end, 7U);
  EXPECT_EQ(parse_frame_range("3:").end, kEnd);
  EXPECT_EQ(parse_frame_range(":7").first, 0U);
  EXPECT_EQ(parse_frame_range(":").end, kEnd);
  EXPECT_EQ(parse_frame_range("").end, kEnd);
}

TEST(FrameRange, RefusesWhatIsNone) {
  for (const char* text :
       {"7", "7:3", "3:3", "a:b", "-1:3", "1:2:3", " 1:2", "1:2 ", "0x1:9", "99999999999999999999:"}) {
    try {
      parse_frame_range(text);
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
    }
  }
}

}  // namespace
}  // namespace facet::pipeline
