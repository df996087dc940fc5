// Spans of takes as new takes, and what people write to a take.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>

#include "facet/error.hpp"
#include "files/disk.hpp"
#include "record_take.hpp"
#include "support/paths.hpp"
#include "take/cutting.hpp"
#include "take/database.hpp"
#include "take/moving.hpp"
#include "take/notes.hpp"
#include "take/picture_records.hpp"
#include "take/reader.hpp"
#include "take/segment.hpp"

namespace facet::take {
namespace {

using testing::HasSubstr;
namespace fs = std::filesystem;

std::string error_of(auto&& work) {
  try {
    work();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

const auto go_on = [](std::int64_t) { return true; };

class CuttingTest : public ::testing::Test {
 protected:
  fs::path file(const std::string& name) const { return folder_.path() / (name + ".take"); }
  CutConfig cut(std::int64_t first, std::int64_t last, const std::string& to = "cut") const {
    return {file("whole"), {first, last}, file(to), "facet tests", 0, {}};
  }
  /// What stands in the takes' folder.
  std::vector<std::string> names() const {
    std::vector<std::string> found;
    for (const auto& entry : fs::directory_iterator(folder_.path())) {
      found.push_back(entry.path().filename().string());
    }
    return found;
  }

  test::TemporaryFolder folder_;
};

TEST_F(CuttingTest, FramesAreTheSameToTheLastBit) {
  test::record_take(file("whole"), 30, test::patch_subject());
  write_notes(file("whole"), {"the better one", "12a", "3"});
  std::vector<std::int64_t> told;
  ASSERT_TRUE(cut_take(cut(7, 18), [&](std::int64_t done) {
    told.push_back(done);
    return true;
  }));
  EXPECT_EQ(told.size(), 12U);
  EXPECT_EQ(told.back(), 12);
  TakeReader whole(file("whole"));
  TakeReader part(file("cut"));
  EXPECT_EQ(part.frame_count(), 12);
  EXPECT_TRUE(part.info().closed);
  EXPECT_EQ(part.info().mesh_frame_count, 10);  // 9 and 14 have no face
  EXPECT_EQ(listed_info(file("cut")).mesh_frame_count, 10);
  EXPECT_EQ(part.info().source, "synthetic patch");
  EXPECT_EQ(part.info().notes, (TakeNotes{"the better one", "12a", "3"}));
  EXPECT_EQ(part.info().cut_from, "whole, frames 7 to 18 of 30");
  for (std::int64_t i = 0; i < part.frame_count(); ++i) {
    const FrameEntry a = whole.entry(i + 7);
    const FrameEntry b = part.entry(i);
    EXPECT_EQ(a.sequence, b.sequence);
    EXPECT_EQ(a.timestamp_ns, b.timestamp_ns);
    EXPECT_EQ(a.media_time_ns, b.media_time_ns);
    EXPECT_EQ(a.has_mesh, b.has_mesh);
    const auto was = whole.frame(i + 7);
    const auto is = part.frame(i);
    EXPECT_EQ(was->control_vertices_mm, is->control_vertices_mm);
    EXPECT_EQ(was->displacements_mm, is->displacements_mm);
    EXPECT_EQ(was->confidence, is->confidence);
    EXPECT_EQ(was->expression, is->expression);
    ASSERT_EQ(was->subject == nullptr, is->subject == nullptr);
    if (is->subject != nullptr) {
      EXPECT_EQ(was->subject->id, is->subject->id);
      ASSERT_NE(is->albedo, nullptr);
      EXPECT_EQ(is->albedo->version, i + 7 < 10 ? 1U : 2U);
      EXPECT_EQ(was->albedo->linear_rgb, is->albedo->linear_rgb);
    }
  }
  EXPECT_EQ(whole.frame_count(), 30) << "the old one is as it was";
  EXPECT_THAT(names(), testing::UnorderedElementsAre("whole.take", "cut.take"));
}

TEST_F(CuttingTest, PicturesGoAlong) {
  test::record_pictures(test::picture_config(file("whole"), 4000), 14);
  ASSERT_GT(TakeReader(file("whole")).info().segments.size(), 2U);
  ASSERT_TRUE(cut_take(cut(5, 11), go_on));
  TakeReader part(file("cut"));
  ASSERT_EQ(part.frame_count(), 7);
  ASSERT_EQ(part.info().segments.size(), 1U);
  EXPECT_EQ(part.info().segments[0].fault, "");
  EXPECT_EQ(part.info().segments[0].frame_count, 7);
  for (std::int64_t i = 0; i < 7; ++i) {
    const auto frame = part.frame(i);
    ASSERT_NE(frame->images, nullptr);
    EXPECT_EQ(frame->images->slot, static_cast<std::uint64_t>(i + 5));
    EXPECT_TRUE(test::same_pictures(*frame->images));
  }
}

TEST_F(CuttingTest, ADamagedPictureIsNotGivenAFreshChecksum) {
  test::record_pictures(test::picture_config(file("whole")), 6);
  {
    std::fstream segment(segment_file(file("whole"), 1), std::ios::in | std::ios::out | std::ios::binary);
    segment.seekp(-40, std::ios::end);
    segment.write("damaged", 7);
  }
  EXPECT_THAT(error_of([&] { cut_take(cut(2, 5), go_on); }),
              testing::AllOf(HasSubstr("pictures of frame 5"), HasSubstr("checksum")));
  EXPECT_THAT(names(), testing::UnorderedElementsAre("whole.take", "whole.frames"));
  EXPECT_TRUE(cut_take(cut(2, 4), go_on)) << "what is sound can be cut out";
}

TEST_F(CuttingTest, BrokenOffOrInTheWayNothingStays) {
  test::record_take(file("whole"), 10, test::patch_subject());
  EXPECT_FALSE(cut_take(cut(0, 9), [](std::int64_t done) { return done < 4; }));
  EXPECT_THAT(names(), testing::UnorderedElementsAre("whole.take"));
  // Somebody takes the name while it is cut.
  EXPECT_THAT(error_of([&] {
                cut_take(cut(0, 9), [&](std::int64_t done) {
                  if (done == 5) {
                    std::ofstream(file("cut")) << "another's";
                  }
                  return true;
                });
              }),
              HasSubstr("is there already"));
  EXPECT_EQ(fs::file_size(file("cut")), 9U);
  EXPECT_THAT(names(), testing::UnorderedElementsAre("whole.take", "cut.take"));
  auto no_room = cut(0, 9, "other");
  no_room.disk_reserve_bytes = std::uint64_t{1} << 62;
  EXPECT_THAT(error_of([&] { cut_take(no_room, go_on); }), HasSubstr("disk nearly full"));
  EXPECT_THAT(names(), testing::UnorderedElementsAre("whole.take", "cut.take"));
}

TEST_F(CuttingTest, TimesAreTheReplays) {
  test::record_take(file("whole"), 30, test::patch_subject());  // 30 a second, from 0
  TakeReader whole(file("whole"));
  const auto span = [&](double from_s, double to_s) {
    const FrameSpan found = frames_between(whole, from_s, to_s);
    return std::pair(found.first, found.last);
  };
  EXPECT_EQ(span(0, 100), std::pair(std::int64_t{0}, std::int64_t{29}));
  EXPECT_EQ(span(0.2, 0.6), std::pair(std::int64_t{6}, std::int64_t{18}));
  EXPECT_THAT(error_of([&] { frames_between(whole, 0.21, 0.22); }), HasSubstr("no frame lies between"));
  EXPECT_THAT(error_of([&] { frames_between(whole, 2, 3); }), HasSubstr("ends at 0.967 s"));
  // A take whose first mesh comes late: a replay begins there.
  TakeRecorder recorder(test::recorder_config(file("late")));
  recorder.start();
  const auto subject = test::patch_subject();
  for (std::uint64_t i = 0; i < 10; ++i) {
    recorder.record(i < 3 ? std::make_shared<mesh::MeshFrame>(test::searching_frame(i))
                          : test::take_frame(i == 4 ? 5 : i, subject));
  }
  recorder.stop();
  TakeReader late(file("late"));
  EXPECT_EQ(frames_between(late, 0, 100).first, 3);
}

TEST_F(CuttingTest, NotesStandInTheTake) {
  test::record_take(file("whole"), 2, test::patch_subject());
  EXPECT_EQ(TakeReader(file("whole")).info().notes, TakeNotes{});
  // The most that a note may be: four bytes each.
  TakeNotes most{"", "Szene 3", "2"};
  for (std::size_t i = 0; i < kMostNoteCharacters; ++i) {
    most.text += "\xF0\x9F\x99\x82";
  }
  write_notes(file("whole"), most);
  EXPECT_EQ(TakeReader(file("whole")).info().notes, most);
  EXPECT_EQ(TakeReader(file("whole")).frame_count(), 2);
  fs::copy_file(file("whole"), file("copy"));
  EXPECT_EQ(listed_info(file("copy")).notes, most);
  write_notes(file("whole"), {"two\nlines", "", ""});
  EXPECT_EQ(TakeReader(file("whole")).info().notes, (TakeNotes{"two\nlines", "", ""}));
  EXPECT_THAT(error_of([&] {
                write_notes(file("whole"), {most.text + "x", "", ""});
              }),
              HasSubstr("2001 characters"));
  EXPECT_THAT(error_of([&] {
                write_notes(file("whole"), {"bell\a", "", ""});
              }),
              HasSubstr("control character"));
  EXPECT_THAT(error_of([&] { write_notes(file("whole"), {"", "two\nlines", ""}); }), HasSubstr("scene"));
  EXPECT_EQ(TakeReader(file("whole")).info().notes.text, "two\nlines") << "what is refused changes nothing";
  // Somebody who writes into it by hand.
  Database(file("whole"), Database::Mode::ReadWrite)
      .execute("INSERT OR REPLACE INTO meta VALUES('scene', 'a' || char(7) || 'b')");
  EXPECT_EQ(TakeReader(file("whole")).info().notes.scene, "a b");
  Database holder(file("whole"), Database::Mode::ReadWrite);
  holder.execute("BEGIN EXCLUSIVE");
  EXPECT_THAT(error_of([&] { write_notes(file("whole"), {"late", "", ""}); }), HasSubstr("try again"));
}

TEST_F(CuttingTest, MovesAllOrNothing) {
  test::record_pictures(test::picture_config(file("whole")), 2);
  std::ofstream(folder_.path() / "whole.keys.json") << "{}";
  std::ofstream(folder_.path() / "whole.basis") << "made of it";
  std::ofstream(folder_.path() / "whole.flac") << "sound";
  const auto moves = moves_of_take(file("whole"), file("other"));
  EXPECT_EQ(moves.back().from, file("whole")) << "its file last";
  std::ofstream(folder_.path() / "other.basis") << "another's";
  const fs::path journal = folder_.path() / ".moves";
  EXPECT_THAT(error_of([&] { move_all(moves, journal); }), HasSubstr("other.basis' is there already"));
  EXPECT_THAT(names(), testing::UnorderedElementsAre("whole.take", "whole.frames", "whole.keys.json",
                                                     "whole.basis", "whole.flac", "other.basis"));
  fs::remove(folder_.path() / "other.basis");
  move_all(moves, journal);
  EXPECT_THAT(names(), testing::UnorderedElementsAre("other.take", "other.frames", "other.keys.json",
                                                     "other.basis", "other.flac"));
  EXPECT_TRUE(test::same_pictures(*TakeReader(file("other")).frame(1)->images));
}

/// Ends the process at the rename of this number; the journal's own is the first.
class DeadlyDisk final : public files::Disk {
 public:
  explicit DeadlyDisk(int deadly) : left_(deadly) {}
  int rename(const char* from, const char* to, unsigned flags) override {
    if (left_-- == 0) {
      ::_exit(0);
    }
    return Disk::rename(from, to, flags);
  }

 private:
  int left_;
};

TEST_F(CuttingTest, WhatACrashLeavesHalfMovedIsMovedBack) {
  test::record_pictures(test::picture_config(file("whole")), 2);
  std::ofstream(folder_.path() / "whole.basis") << "made of it";
  std::ofstream(folder_.path() / "whole.flac") << "sound";
  const fs::path journal = folder_.path() / ".moves";
  const auto before = names();
  const auto moves = moves_of_take(file("whole"), file("other"));
  for (int renames = 1; renames <= static_cast<int>(moves.size()); ++renames) {
    SCOPED_TRACE(renames);
    const pid_t child = ::fork();
    if (child == 0) {
      DeadlyDisk disk(renames);
      const files::InstalledDisk installed(disk);
      move_all(moves, journal);
      ::_exit(1);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_EQ(status, 0) << "it was to end while it moved";
    EXPECT_EQ(fs::exists(folder_.path() / "whole.frames"), renames < 2);
    EXPECT_TRUE(undo_moves(journal));
    EXPECT_THAT(names(), testing::UnorderedElementsAreArray(before));
    EXPECT_FALSE(undo_moves(journal)) << "once";
  }
}

TEST(Renumber, ChangesTheNumberAlone) {
  const auto frame = test::picture_frame(3);
  std::vector<std::uint8_t> records;
  PictureWriter writer;
  ASSERT_TRUE(writer.append(*frame->images, 40, records));
  std::vector<std::uint8_t> expected;
  ASSERT_TRUE(writer.append(*frame->images, 7, expected));
  EXPECT_THAT(error_of([&] { renumber(records, 41, 7); }), HasSubstr("of frame 40 stands here"));
  renumber(records, 40, 7);
  EXPECT_EQ(records, expected);
  records.pop_back();
  EXPECT_THAT(error_of([&] { renumber(records, 7, 8); }), HasSubstr("cut off"));
}

}  // namespace
}  // namespace facet::take
