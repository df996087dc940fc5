// Files from outside: read in pieces, whatever they are and whatever becomes of them.

#include "files/text_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <array>
#include <fstream>

#include "facet/error.hpp"
#include "support/paths.hpp"

namespace facet::files {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

template <typename Work>
std::string refusal(const Work& work) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return "no error";
}

class InputFileTest : public ::testing::Test {
 protected:
  InputFileTest() { std::ofstream(file_) << "0123456789"; }
  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "ten.bin";
};

TEST_F(InputFileTest, GivesTheBytesOfAPlace) {
  const InputFile in(file_, "thing");
  EXPECT_EQ(in.size(), 10U);
  std::array<std::byte, 3> bytes{};
  in.read(7, bytes);
  EXPECT_EQ(bytes, (std::array{std::byte{'7'}, std::byte{'8'}, std::byte{'9'}}));
  EXPECT_THAT(refusal([&] { in.read(8, bytes); }),
              AllOf(HasSubstr(file_.string()), HasSubstr("this thing"), HasSubstr("ends at byte 10")));
}

TEST_F(InputFileTest, AFileThatIsShortenedMeanwhileIsAnError) {
  const InputFile in(file_, "thing");
  std::filesystem::resize_file(file_, 4);
  std::array<std::byte, 10> bytes{};
  EXPECT_THAT(refusal([&] { in.read(0, bytes); }), HasSubstr("ends at byte 4"));
}

TEST_F(InputFileTest, WhatIsNoFileIsRefusedAtOnce) {
  const auto pipe = folder_.path() / "pipe";
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  for (const std::filesystem::path& place : {pipe, folder_.path(), std::filesystem::path("/dev/zero")}) {
    EXPECT_THAT(refusal([&] { read_bytes(place, 100, "thing"); }), HasSubstr("not a regular file"));
  }
  EXPECT_THAT(refusal([&] { read_bytes(folder_.path() / "none", 100, "thing"); }), HasSubstr("No such file"));
}

TEST_F(InputFileTest, TooLargeIsRefusedBeforeMemoryIsTaken) {
  EXPECT_EQ(read_bytes(file_, 10, "thing").size(), 10U);
  EXPECT_THAT(refusal([&] { read_bytes(file_, 9, "thing"); }), HasSubstr("larger than 9 bytes"));
  std::filesystem::resize_file(file_, std::uintmax_t{1} << 40);  // sparse
  EXPECT_THAT(refusal([&] { read_bytes(file_, 1 << 20, "thing"); }), HasSubstr("larger than"));
}

}  // namespace
}  // namespace facet::files
