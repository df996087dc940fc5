// `facet import`: pictures that others recorded become a take of a booth's pictures.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "files/image_file.hpp"
#include "slot_program.hpp"
#include "support/child_process.hpp"
#include "support/paths.hpp"
#include "support/videos.hpp"
#include "take/reader.hpp"

namespace facet::tools {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class Import : public ::testing::Test {
 protected:
  static constexpr int kWidth = 48;
  static constexpr int kHeight = 32;

  int run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "import");
    test::ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log");
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }

  /// A picture with stripes, or an even one, of 16 bits.
  void write(const std::string& camera, int number, bool lit, std::uint16_t grey = 30000,
             int width = kWidth) const {
    std::filesystem::create_directories(folder_.path() / camera);
    std::vector<std::uint16_t> values(static_cast<std::size_t>(width) * kHeight, grey);
    for (std::size_t i = 0; lit && i < values.size(); ++i) {
      values[i] = i % static_cast<std::size_t>(width) / 4 % 2 == 0 ? 50000 : 8000;
    }
    const std::vector<std::uint8_t> bytes = files::encode_png(width, kHeight, values);
    std::ofstream(folder_.path() / camera / fmt_name(number), std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  }
  static std::string fmt_name(int number) { return "shot_b2_" + std::to_string(number) + ".png"; }

  /// Pictures 100 to 111 of two cameras; blank where number % 3 is `blank`.
  void write_booth(int blank) const {
    for (int number = 100; number < 112; ++number) {
      for (const char* camera : {"left", "right"}) {
        write(camera, number, number % 3 != blank);
      }
    }
  }

  test::TemporaryFolder folder_;
  std::string output_;
};

TEST_F(Import, PicturesOfOneNumberAreOneSlotAndBlankOnesAreFound) {
  write_booth(0);
  std::filesystem::remove(folder_.path() / "right" / fmt_name(105));  // 102, 105, ... are blank
  ASSERT_EQ(run({"left=" + file("left"), "right=" + file("right"), "--rate", "60", "-o", file("a.take")}), 0)
      << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("12 slots of 2 cameras"), HasSubstr("1 pictures missing")));
  take::TakeReader take(file("a.take"));
  ASSERT_EQ(take.frame_count(), 12);
  for (std::int64_t i = 0; i < 12; ++i) {
    const auto set = take.frame(i)->images;
    ASSERT_NE(set, nullptr);
    EXPECT_EQ(set->slot % 3 == 2, (100 + i) % 3 == 0) << "the program's third slot is the blank one";
    EXPECT_EQ(set->light, set->slot % 3 == 2 ? "blank" : "stripes");
    EXPECT_EQ(set->missing, i == 5 ? 2U : 0U);
    EXPECT_EQ(*set->camera_names, (std::vector<std::string>{"left", "right"}));
    EXPECT_NEAR(static_cast<double>(take.entry(i).media_time_ns), 1e9 / 60 * static_cast<double>(i), 1);
  }
  EXPECT_EQ(take.frame(2)->images->frames[0].row(0)[0], 117) << "30000 of 65535";
  EXPECT_EQ(recorded_program(take, {0, 1, 2, 3, 4, 5, 6}), capture::standard_program());
  EXPECT_EQ(recorded_program(take, {0, 1}), std::nullopt) << "no period can be told by two slots";
}

TEST_F(Import, LinearPicturesAreCodedAnew) {
  write_booth(2);
  ASSERT_EQ(run({"left=" + file("left"), "right=" + file("right"), "--grey", "linear", "-o", file("a.take")}),
            0)
      << output_;
  take::TakeReader take(file("a.take"));
  EXPECT_EQ(take.frame(1)->images->frames[0].row(0)[0], 180) << "sRGB of 30000 / 65535";
}

TEST_F(Import, WhatDoesNotFitIsNamedWithWhatToDo) {
  write_booth(0);
  const std::vector<std::string> both = {"left=" + file("left"), "right=" + file("right"), "-o",
                                         file("a.take")};
  write("right", 107, true, 30000, kWidth + 4);
  EXPECT_EQ(run(both), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr("picture 107 of camera 'right' is 52 x 32"), HasSubstr("48 x 32")));
  EXPECT_FALSE(std::filesystem::exists(file("a.take")))
      << "nothing is left that the next run would stumble over";
  EXPECT_FALSE(std::filesystem::exists(file("a.frames")));

  // One camera counts a slot late.
  for (int number = 100; number < 112; ++number) {
    write("right", number, number % 3 != 1);
  }
  EXPECT_EQ(run(both), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr("'right' come 1 slots later"), HasSubstr("--shift right=1")));
  std::vector<std::string> mended = both;
  mended.insert(mended.end(), {"--shift", "right=1"});
  EXPECT_EQ(run(mended), 0) << output_;
  std::filesystem::remove(file("a.take"));
  std::filesystem::remove_all(file("a.frames"));

  // Nothing is blank.
  for (int number = 100; number < 112; ++number) {
    write("left", number, true);
    write("right", number, true);
  }
  EXPECT_EQ(run(both), 3);
  EXPECT_THAT(output_, AllOf(HasSubstr("no camera tells"), HasSubstr("--start")));
  std::vector<std::string> said = both;
  said.insert(said.end(), {"--start", "1"});
  EXPECT_EQ(run(said), 0) << output_;
  EXPECT_EQ(take::TakeReader(file("a.take")).entry(0).sequence, 1U);

  EXPECT_EQ(run({"left" + file("left"), "-o", file("b.take")}), 2);
  EXPECT_EQ(run({"left=" + file("left"), "left=" + file("right"), "-o", file("b.take")}), 2);
  EXPECT_EQ(run({"left=" + file("nowhere"), "-o", file("b.take")}), 3);
  EXPECT_EQ(run({"left=" + file("left"), "--program", "blank,blank", "-o", file("b.take")}), 2);
  EXPECT_EQ(run({"left=" + file("left"), "--shift", "top=1", "-o", file("b.take")}), 2);
}

TEST_F(Import, VideosAreShiftedAsFoldersAre) {
  test::write_grey_video(file("left.mkv"), 6);
  test::write_grey_video(file("right.mkv"), 6);
  ASSERT_EQ(run({"left=" + file("left.mkv"), "right=" + file("right.mkv"), "--start", "0", "--shift",
                 "right=1", "-o", file("a.take")}),
            0)
      << output_;
  take::TakeReader take(file("a.take"));
  ASSERT_EQ(take.frame_count(), 7) << "the first slot of the one, the last of the other";
  EXPECT_EQ(take.frame(0)->images->missing, 1U);
  for (std::int64_t i = 1; i < 6; ++i) {
    EXPECT_EQ(take.frame(i)->images->missing, 0U) << i;
  }
  EXPECT_EQ(take.frame(6)->images->missing, 2U);
}

TEST_F(Import, ANumberThatIsATimeIsNoSlot) {
  write_booth(0);
  std::filesystem::copy(folder_.path() / "left" / fmt_name(100),
                        folder_.path() / "left" / "thumb_20261129123456.png");
  EXPECT_EQ(run({"left=" + file("left"), "-o", file("a.take")}), 2);
  EXPECT_THAT(output_, HasSubstr("more slots than an import has"));
}

TEST(ProgramStart, AStartIsToldWhereItsBlankSlotsAreClearlyEven) {
  const capture::SlotProgram program = capture::standard_program();
  EXPECT_EQ(find_program_start({9, 2, 9, 8, 2, 9}, program).first, 1U);
  EXPECT_TRUE(find_program_start({9, 2, 9, 8, 2, 9}, program).told);
  EXPECT_FALSE(find_program_start({9, 9, 9, 9, 8, 9}, program).told);
  EXPECT_FALSE(find_program_start({}, program).told);
  const capture::SlotProgram lamp =
      capture::parse_slot_program("stripes,stripes,blank,stripes,stripes,light:top");
  EXPECT_FALSE(find_program_start({9, 9, 2, 9, 9, 2}, lamp).told) << "a lamp is as even as blank light";
  const capture::SlotProgram fringes = capture::fringe_program();
  EXPECT_EQ(find_program_start({9, 2, 9, 8, 2, 9}, fringes).first, 1U) << "half a period more is the same";
  EXPECT_EQ(find_program_start({9, 2, 9, 8, 2, 9}, fringes).repeats_after, 3U);
  EXPECT_TRUE(find_program_start({9, 2, 9, 8, 2, 9}, fringes).told);
  EXPECT_EQ(find_program_start({0, 2, 9, 8, 2, 9}, program).first, 1U) << "a picture is missing";
}

}  // namespace
}  // namespace facet::tools
