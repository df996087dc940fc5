#include "files/pfm.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <string>

#include "facet/error.hpp"
#include "support/paths.hpp"

namespace facet::files {
namespace {

using ::testing::HasSubstr;

std::string why_refused(const std::string& bytes) {
  try {
    parse_pfm(std::as_bytes(std::span(bytes)), "some.pfm");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return "taken";
}

std::string bytes_of(std::initializer_list<float> values) {
  std::string bytes;
  for (const float value : values) {
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  return bytes;
}

TEST(Pfm, ReadsBackWhatWasWritten) {
  const test::TemporaryFolder folder;
  FloatImage image{13, 7, {}};
  for (int k = 0; k < 13 * 7; ++k) {
    image.values.push_back(std::ldexp(static_cast<float>(k), -k));
  }
  image.values[5] = std::numeric_limits<float>::infinity();
  write_pfm(image, folder.path() / "depth.pfm");
  const FloatImage read = read_pfm(folder.path() / "depth.pfm");
  EXPECT_EQ(read.width_px, 13);
  EXPECT_EQ(read.height_px, 7);
  EXPECT_EQ(read.values, image.values);
}

TEST(Pfm, TheBottomRowComesFirst) {
  const std::string bytes = "Pf\n2 2\n-1.0\n" + bytes_of({3, 4, 1, 2});
  EXPECT_EQ(parse_pfm(std::as_bytes(std::span(bytes)), "").values, (std::vector<float>{1, 2, 3, 4}));
}

TEST(Pfm, WhatIsNoneIsRefusedWithTheReason) {
  EXPECT_THAT(why_refused(""), HasSubstr("some.pfm: not a portable float map: its header has no end"));
  EXPECT_THAT(why_refused("PF\n1 1\n-1.0\n" + bytes_of({1, 1, 1})), HasSubstr("'Pf'"));
  EXPECT_THAT(why_refused("Pf\n0 1\n-1.0\n"), HasSubstr("'0' is not a side"));
  EXPECT_THAT(why_refused("Pf\n1 99999\n-1.0\n"), HasSubstr("'99999' is not a side"));
  EXPECT_THAT(why_refused("Pf\n1 1x\n-1.0\n"), HasSubstr("'1x' is not a side"));
  EXPECT_THAT(why_refused("Pf\n1 1\n1.0\n" + bytes_of({1})), HasSubstr("little-endian"));
  EXPECT_THAT(why_refused("Pf\n1 1\nnan\n" + bytes_of({1})), HasSubstr("little-endian"));
  EXPECT_THAT(why_refused("Pf\n2 1\n-1.0\n" + bytes_of({1})), HasSubstr("4 bytes of values instead of 8"));
  EXPECT_THAT(why_refused("Pf\n1 1\n-1.0\n" + bytes_of({1, 1})), HasSubstr("8 bytes"));
  EXPECT_THROW(read_pfm("/nowhere/at.pfm"), Error);
}

}  // namespace
}  // namespace facet::files
