#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <fstream>
#include <iterator>
#include <random>

#include "facet/error.hpp"
#include "record_take.hpp"
#include "support/paths.hpp"
#include "support/set_clock.hpp"
#include "take/database.hpp"
#include "take/reader.hpp"
#include "take/take_file.hpp"

namespace facet::take {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::string rejection(auto&& work, ErrorKind kind = ErrorKind::UnreadableInput) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), kind) << error.what();
    return error.what();
  }
  return "";
}

class Reader : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  std::filesystem::path file = folder.path() / "one.take";
  std::shared_ptr<const mesh::Subject> subject = test::patch_subject();

  void change(const std::string& sql) {
    sqlite3* database = nullptr;
    ASSERT_EQ(sqlite3_open(file.c_str(), &database), SQLITE_OK);
    EXPECT_EQ(sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr), SQLITE_OK)
        << sqlite3_errmsg(database);
    sqlite3_close(database);
  }
  std::string open_error() {
    return rejection([&] { TakeReader{file}; });
  }
  std::string unavailable() {
    return rejection([&] { TakeReader{file}; }, ErrorKind::Unavailable);
  }
  std::string frame_error(std::int64_t index) {
    return rejection([&] { TakeReader(file).frame(index); });
  }
};

TEST_F(Reader, GivesBackWhatWasRecorded) {
  {
    const std::chrono::sys_days day(std::chrono::year(2026) / 11 / 21);
    const test::SetClock clock(1'000'000'000, day + std::chrono::minutes(570));
    test::record_take(file, 20, subject);
  }
  TakeReader reader(file);
  const TakeInfo& info = reader.info();
  EXPECT_EQ(info.format_version, kFormatVersion);
  EXPECT_EQ(info.source, "synthetic patch");
  EXPECT_EQ(info.software, "facet tests");
  EXPECT_EQ(info.frame_count, 20);
  EXPECT_EQ(info.mesh_frame_count, 16);
  EXPECT_EQ(info.subject_count, 1);
  EXPECT_EQ(info.first_timestamp_ns, test::take_frame(0, subject)->timestamp_ns);
  EXPECT_EQ(info.last_timestamp_ns, test::take_frame(19, subject)->timestamp_ns);
  EXPECT_EQ(info.created_utc, "2026-11-21T09:30:00Z");
  EXPECT_EQ(info.file_bytes, std::filesystem::file_size(file));

  for (const std::int64_t index : {19, 0, 7, 4, 12, 7}) {
    const auto sent = test::take_frame(static_cast<std::uint64_t>(index), subject);
    const FrameEntry entry = reader.entry(index);
    EXPECT_EQ(entry.sequence, sent->sequence);
    EXPECT_EQ(entry.timestamp_ns, sent->timestamp_ns);
    EXPECT_EQ(entry.state, sent->state);
    EXPECT_EQ(entry.has_mesh, sent->subject != nullptr);
    const auto got = reader.frame(index);
    EXPECT_EQ(got->sequence, sent->sequence);
    EXPECT_EQ(got->landmarks_px, sent->landmarks_px);
    if (sent->subject == nullptr) {
      EXPECT_EQ(got->subject, nullptr);
      continue;
    }
    EXPECT_EQ(got->subject->id, subject->id);
    EXPECT_EQ(got->albedo->version, index < 10 ? 1U : 2U);
    EXPECT_EQ(got->expression, sent->expression);
    EXPECT_LE((got->control_vertices_mm - sent->control_vertices_mm).cwiseAbs().maxCoeff(), 0.01F);
  }
  EXPECT_EQ(reader.frame(0)->subject, reader.frame(1)->subject) << "frames share their subject";
  EXPECT_EQ(reader.frame(0)->albedo, reader.frame(1)->albedo);
}

TEST_F(Reader, EachFrameHasItsSubject) {
  TakeRecorder recorder(test::recorder_config(file));
  recorder.start();
  const auto other = test::patch_subject(7, 5);
  recorder.record(test::take_frame(0, subject));
  recorder.record(test::take_frame(1, other));
  recorder.record(test::take_frame(2, subject));
  recorder.stop();
  TakeReader reader(file);
  EXPECT_EQ(reader.info().subject_count, 2);
  EXPECT_EQ(reader.frame(1)->subject->id, 7U);
  EXPECT_EQ(reader.frame(2)->subject->id, subject->id);
  EXPECT_EQ(reader.frame(2)->albedo->version, 1U);
}

TEST_F(Reader, SubjectsThatNobodyHasAreLetGo) {
  constexpr std::uint64_t kSubjects = 150;
  {
    TakeRecorder recorder(test::recorder_config(file));
    recorder.start();
    for (std::uint64_t index = 0; index < kSubjects; ++index) {
      const auto one = test::patch_subject(1000 + index, 3, 1);
      recorder.record(std::make_shared<mesh::MeshFrame>(test::patch_frame(index, one, nullptr)));
    }
    recorder.stop();
  }
  TakeReader reader(file);
  const auto kept = reader.frame(0);
  std::vector<std::weak_ptr<const mesh::Subject>> seen;
  const auto alive = [&seen] {
    return std::count_if(seen.begin(), seen.end(), [](const auto& one) { return !one.expired(); });
  };
  for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
    seen.push_back(reader.frame(index)->subject);
    EXPECT_LE(alive(), 3) << "after frame " << index;  // the last two and the one that is held here
  }
  EXPECT_EQ(seen.size(), kSubjects);
  EXPECT_EQ(reader.frame(0)->subject, kept->subject) << "what somebody has is shared, not read again";
}

/// Most bytes that SQLite had at a time during the work.
std::int64_t memory_of(auto&& work) {
  sqlite3_memory_highwater(1);
  const std::int64_t before = sqlite3_memory_used();
  work();
  return sqlite3_memory_highwater(0) - before;
}

TEST_F(Reader, LongTextsAreRefusedUnread) {
  constexpr std::int64_t kFewBytes = 4 << 20;
  test::record_take(file, 3, subject);
  const std::string long_text = "printf('%.*c', 60000000, 'x')";
  for (const std::string& sql :
       {"INSERT OR REPLACE INTO meta VALUES('created_utc', " + long_text + ")",
        "DELETE FROM meta WHERE key = 'created_utc'; INSERT INTO meta VALUES(" + long_text + ", 'x')",
        "DELETE FROM meta WHERE length(key) > 1000; UPDATE frame SET timestamp_ns = " + long_text +
            " WHERE number = 0"}) {
    change(sql);
    std::string said;
    EXPECT_LT(memory_of([&] { said = open_error(); }), kFewBytes);
    EXPECT_THAT(said, AllOf(HasSubstr(file.string()), HasSubstr("longer than any of a take")));
    EXPECT_LT(memory_of([&] { said = rejection([&] { listed_info(file); }); }), kFewBytes);
    EXPECT_THAT(said, HasSubstr("longer than any of a take"));
  }
}

TEST_F(Reader, TooManyTextsAreRefused) {
  test::record_take(file, 3, subject);
  change(
      "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 100) "
      "INSERT INTO meta SELECT 'more' || k, 'x' FROM n");
  EXPECT_THAT(open_error(), HasSubstr("more than 64"));
}

TEST_F(Reader, TextsAreCutBetweenCharacters) {
  TakeRecorderConfig config = test::recorder_config(file);
  for (int k = 0; k < 3000; ++k) {
    config.source += "\xC3\xA4";
  }
  const std::size_t odd = config.source.size() % 2;
  TakeRecorder(config).stop();
  const std::string source = TakeReader(file).info().source;
  EXPECT_EQ(source, config.source.substr(0, kMaxMetaBytes - (kMaxMetaBytes - odd) % 2));
  change("UPDATE meta SET value = printf('%.*c', 3000, 'x') WHERE key = 'end_reason'");
  EXPECT_EQ(TakeReader(file).info().end_reason, std::string(kMaxShownBytes, 'x'));
  EXPECT_EQ(listed_info(file).end_reason, std::string(kMaxShownBytes, 'x'));
}

TEST_F(Reader, ListedInfoIsThatOfTheReader) {
  test::record_take(file, 20, subject);
  const std::filesystem::path pictures = folder.path() / "two.take";
  test::record_pictures(test::picture_config(pictures, 20'000), 20);
  for (const auto& take : {file, pictures}) {
    const TakeInfo listed = listed_info(take);
    const TakeReader reader(take);
    const TakeInfo& info = reader.info();
    EXPECT_EQ(listed.file, info.file);
    EXPECT_EQ(listed.format_version, info.format_version);
    EXPECT_EQ(listed.created_utc, info.created_utc);
    EXPECT_TRUE(listed.closed);
    EXPECT_EQ(listed.frame_count, 20);
    EXPECT_EQ(listed.mesh_frame_count, info.mesh_frame_count);
    EXPECT_EQ(listed.first_timestamp_ns, info.first_timestamp_ns);
    EXPECT_EQ(listed.last_timestamp_ns, info.last_timestamp_ns);
    EXPECT_EQ(listed.picture_bytes, info.picture_bytes);
    EXPECT_EQ(listed.file_bytes, info.file_bytes);
  }
  EXPECT_GT(TakeReader(pictures).info().segments.size(), 2U);
}

TEST_F(Reader, MeshesAreCountedWhereTheRecorderDidNotSay) {
  test::record_take(file, 20, subject);
  change("UPDATE meta SET value = '3' WHERE key = 'mesh_frames'");
  EXPECT_EQ(listed_info(file).mesh_frame_count, 3) << "a list takes the recorder's word";
  EXPECT_EQ(TakeReader(file).info().mesh_frame_count, 16);
  change("UPDATE meta SET value = '99999999999999999999' WHERE key = 'mesh_frames'");
  EXPECT_EQ(listed_info(file).mesh_frame_count, 20) << "no more than there are frames";
  change("UPDATE meta SET value = '0' WHERE key = 'closed'");
  EXPECT_EQ(listed_info(file).mesh_frame_count, 16);
  change("UPDATE meta SET value = '1' WHERE key = 'closed'; DELETE FROM meta WHERE key = 'mesh_frames'");
  EXPECT_EQ(listed_info(file).mesh_frame_count, 16) << "of an older recorder";
}

TEST_F(Reader, SegmentsWithoutEndAreRefused) {
  test::record_pictures(test::picture_config(file), 3);
  change("UPDATE pictures SET segment = 1000000000000 WHERE number = 2");
  EXPECT_THAT(open_error(), HasSubstr("segment 1000000000000"));
  change("UPDATE pictures SET segment = -1 WHERE number = 2");
  EXPECT_THAT(open_error(), HasSubstr("segment -1"));
}

TEST_F(Reader, IndexBeyondTheEndIsAUsageError) {
  test::record_take(file, 3, subject);
  TakeReader reader(file);
  for (const std::int64_t index : {std::int64_t{-1}, std::int64_t{3}}) {
    try {
      reader.frame(index);
      ADD_FAILURE() << index;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
    }
  }
}

TEST_F(Reader, ForeignFilesAreNamed) {
  EXPECT_THAT(open_error(), HasSubstr("no such file"));
  std::ofstream(file) << std::string(10000, 'x');
  EXPECT_THAT(open_error(), HasSubstr("not an SQLite file"));
  std::filesystem::remove(file);
  std::ofstream(file).flush();
  EXPECT_THAT(open_error(), HasSubstr("not a take"));
  std::filesystem::remove(file);
  change("CREATE TABLE frame(x)");
  EXPECT_THAT(open_error(), AllOf(HasSubstr("not a take"), HasSubstr(file.string())));
  EXPECT_THAT(rejection([&] { TakeReader{folder.path()}; }), HasSubstr("not a file"));
}

TEST_F(Reader, WhatAnotherHoldsLockedIsUnavailableAndNotUnreadable) {
  test::record_take(file, 3, subject);
  {
    Database holder(file, Database::Mode::ReadWrite);
    holder.execute("BEGIN EXCLUSIVE");
    EXPECT_THAT(unavailable(), AllOf(HasSubstr(file.string()), HasSubstr("another program holds it locked")));
    EXPECT_THAT(rejection([&] { listed_info(file); }, ErrorKind::Unavailable), HasSubstr("try again"));
  }
  TakeReader reader(file);
  Database holder(file, Database::Mode::ReadWrite);
  holder.execute("BEGIN EXCLUSIVE");
  EXPECT_THAT(rejection([&] { reader.frame(0); }, ErrorKind::Unavailable), HasSubstr("locked"));
  holder.execute("ROLLBACK");
  EXPECT_EQ(reader.frame(0)->sequence, 0U);
}

TEST_F(Reader, ATakeThatCantBeOpenedNowIsUnavailable) {
  test::record_take(file, 3, subject);
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before), 0);
  const int next = ::dup(0);
  ASSERT_GE(next, 0);
  ::close(next);
  const rlimit none_left{static_cast<rlim_t>(next), before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &none_left), 0);
  const std::string refused = unavailable();
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_THAT(refused, AllOf(HasSubstr(file.string()), HasSubstr("opened now"), HasSubstr("try again")));
  EXPECT_EQ(TakeReader(file).frame_count(), 3);
}

TEST_F(Reader, ATakeThatNobodyMayReadIsUnreadable) {
  test::record_take(file, 3, subject);
  ASSERT_EQ(::chmod(folder.path().c_str(), 0755) | ::chmod(file.c_str(), 0), 0);
  const bool root = ::geteuid() == 0;
  ASSERT_TRUE(!root || ::seteuid(65534) == 0);  // root may read everything
  const std::string refused = open_error();
  ASSERT_TRUE(!root || ::seteuid(0) == 0);
  EXPECT_THAT(refused, HasSubstr("Permission denied"));
}

TEST_F(Reader, NewerVersionIsNamed) {
  test::record_take(file, 3, subject);
  change(fmt::format("PRAGMA user_version = {}", kFormatVersion + 1));
  EXPECT_THAT(open_error(), AllOf(HasSubstr(fmt::format("format version is {}", kFormatVersion + 1)),
                                  HasSubstr("newer Facet")));
}

TEST_F(Reader, StrangeTablesAreRefused) {
  test::record_take(file, 3, subject);
  change("CREATE VIEW spy AS SELECT 1");
  EXPECT_THAT(open_error(), HasSubstr("table 'spy'"));
  change("DROP VIEW spy");
  change("PRAGMA user_version = 1");
  EXPECT_THAT(open_error(), HasSubstr("table 'pictures'")) << "version 1 had none";
  change(fmt::format("PRAGMA user_version = {}; DROP TABLE albedo", kFormatVersion));
  EXPECT_THAT(open_error(), HasSubstr("missing"));
  change("CREATE VIEW albedo AS SELECT 1 AS subject_id, 1 AS version, x'00' AS data");
  EXPECT_THAT(open_error(), HasSubstr("table 'albedo'"));
}

TEST_F(Reader, DamagedContentIsNamedWithItsFrame) {
  test::record_take(file, 6, subject);
  change("UPDATE frame_data SET data = x'0102030405' WHERE number = 1");
  change("UPDATE frame_data SET data = (SELECT data FROM subject LIMIT 1) WHERE number = 2");
  change("UPDATE frame SET state = 77 WHERE number = 3");
  change("DELETE FROM frame_data WHERE number = 5");
  EXPECT_THAT(frame_error(1), HasSubstr("frame 1"));
  EXPECT_THAT(frame_error(2), AllOf(HasSubstr("frame 2"), HasSubstr("not a frame")));
  EXPECT_THAT(rejection([&] { TakeReader(file).entry(3); }), HasSubstr("state 77"));
  EXPECT_THAT(frame_error(5), HasSubstr("frame 5 is missing"));
  EXPECT_EQ(TakeReader(file).frame(0)->sequence, 0U) << "sound frames stay readable";
  change("UPDATE subject SET data = zeroblob(100)");
  EXPECT_THAT(frame_error(0), HasSubstr("subject"));
  change("DELETE FROM frame WHERE number = 2");
  EXPECT_THAT(open_error(), HasSubstr("frames are missing"));
}

TEST_F(Reader, ASecondTopologyUnderOneIdIsRefused) {
  const auto of_id_7 = [](const mesh::Subject& like) {
    auto out = std::make_shared<mesh::Subject>(like);
    auto hierarchy = std::make_shared<mesh::Hierarchy>(*like.hierarchy);
    hierarchy->id = 7;
    out->hierarchy = std::move(hierarchy);
    return out;
  };
  const auto same = of_id_7(*test::patch_subject(3, 5));
  {
    TakeRecorder recorder(test::recorder_config(file));
    recorder.start();
    recorder.record(test::take_frame(0, of_id_7(*test::patch_subject(1, 5))));
    recorder.record(test::take_frame(1, of_id_7(*test::patch_subject(2, 4))));
    recorder.record(test::take_frame(2, same));
    recorder.stop();
  }
  TakeReader reader(file);
  EXPECT_EQ(reader.frame(0)->subject->id, 1U);
  EXPECT_THAT(rejection([&] { reader.frame(1); }), AllOf(HasSubstr("another topology"), HasSubstr("07")));
  EXPECT_EQ(reader.frame(2)->subject->id, 3U) << "two subjects may share one";
}

TEST_F(Reader, SubjectUnderAnotherIdIsNoticed) {
  test::record_take(file, 2, subject);
  const auto other = test::patch_subject(7, 5);
  const std::filesystem::path second = folder.path() / "two.take";
  test::record_take(second, 2, other);
  change("ATTACH '" + second.string() + "' AS two; UPDATE subject SET data = (SELECT data FROM two.subject)");
  EXPECT_THAT(frame_error(0), HasSubstr("subject"));
}

/// Reads everything in a file; what is not readable must be an Error.
void read_all(const std::filesystem::path& file) {
  try {
    TakeReader reader(file);
    for (std::int64_t index = 0; index < std::min<std::int64_t>(reader.frame_count(), 100); ++index) {
      try {
        reader.entry(index);
        reader.frame(index);
      } catch (const Error&) {
        continue;
      }
    }
  } catch (const Error&) {
    return;
  }
}

TEST_F(Reader, TruncatedAndFlippedFilesNeverCrash) {
  constexpr unsigned kSeed = 4711;
  std::mt19937 random(kSeed);
  test::record_take(file, 6, test::patch_subject(5, 3, 1));
  std::ifstream stream(file, std::ios::binary);
  const std::string sound{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  const std::filesystem::path damaged = folder.path() / "damaged.take";
  int refused = 0;
  for (int round = 0; round < 300; ++round) {
    std::string bytes = sound;
    if (round % 3 == 0) {
      bytes.resize(random() % bytes.size());
    } else {
      for (int flip = 0; flip < 40; ++flip) {
        bytes[random() % bytes.size()] = static_cast<char>(random());
      }
      bytes[random() % 200] = static_cast<char>(random());
    }
    std::ofstream(damaged, std::ios::binary) << bytes;
    read_all(damaged);
    try {
      TakeReader{damaged};
    } catch (const Error&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 50) << "seed " << kSeed;
}

}  // namespace
}  // namespace facet::take
