#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <ctime>
#include <fstream>
#include <functional>
#include <iterator>
#include <optional>
#include <string>
#include <thread>

#include "facet/error.hpp"
#include "record_take.hpp"
#include "support/paths.hpp"
#include "support/refused_threads.hpp"
#include "support/small_disk.hpp"
#include "system_calls.hpp"
#include "take/closing.hpp"
#include "take/database.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet::take {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;

class Recorder : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  std::filesystem::path file = folder.path() / "one.take";
  std::shared_ptr<const mesh::Subject> subject = test::patch_subject();
};

std::string storage_error(auto&& work) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    return error.what();
  }
  return "";
}

TEST_F(Recorder, ClosedTakeIsOneFile) {
  const RecorderStatus status = test::record_take(file, 12, subject);
  EXPECT_EQ(status.state, RecorderState::Finished);
  EXPECT_THAT(status.reason, IsEmpty());
  EXPECT_EQ(status.frames, 12U);
  EXPECT_EQ(status.mesh_frames, 10U);
  EXPECT_EQ(status.dropped, 0U);
  const std::int64_t bytes = Database(file, Database::Mode::ReadOnly)
                                 .query_int64(
                                     "SELECT (SELECT sum(length(data)) FROM subject) + (SELECT "
                                     "ifnull(sum(length(data)), 0) FROM albedo) + (SELECT sum(length(data)) "
                                     "FROM frame_data)");
  EXPECT_EQ(static_cast<std::int64_t>(status.bytes), bytes) << "all that was written of it";
  int files = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder.path())) {
    ++files;
  }
  EXPECT_EQ(files, 1);
  EXPECT_TRUE(TakeReader(file).info().closed);
}

TEST_F(Recorder, PicturesAreRecordedWhereTheyAreWanted) {
  auto set = std::make_shared<FrameSet>();
  set->slot = 9;
  set->camera_names = std::make_shared<const std::vector<std::string>>(1, "left");
  set->frames.resize(1);
  Frame& picture = set->frames[0];
  picture.width_px = 2;
  picture.height_px = 2;
  picture.stride_bytes = 8;
  const std::vector<std::uint8_t> pixels = {1, 2, 3, 255, 4, 5, 6, 255, 7, 8, 9, 255, 10, 11, 12, 255};
  auto shared = std::make_shared<std::uint8_t[]>(pixels.size());
  std::copy(pixels.begin(), pixels.end(), shared.get());
  picture.pixels = std::move(shared);
  auto frame = std::make_shared<mesh::MeshFrame>();
  frame->images = set;
  for (const bool with_images : {false, true}) {
    TakeRecorderConfig config =
        test::recorder_config(folder.path() / (with_images ? "with.take" : "without.take"));
    config.with_images = with_images;
    TakeRecorder recorder(config);
    recorder.start();
    recorder.record(frame);
    EXPECT_EQ(recorder.stop().frames, 1U);
    TakeReader reader(config.file);
    const auto got = reader.frame(0)->images;
    ASSERT_NE(got, nullptr);
    EXPECT_EQ(got->slot, 9U);
    ASSERT_EQ(got->frames[0].empty(), !with_images);
    if (with_images) {
      EXPECT_TRUE(std::equal(pixels.begin(), pixels.end(), got->frames[0].pixels.get()));
    }
  }
}

TEST_F(Recorder, ExistingFileIsNeverOverwritten) {
  std::ofstream(file) << "precious";
  EXPECT_THAT(storage_error([&] { const TakeRecorder recorder(test::recorder_config(file)); }),
              HasSubstr("exists already"));
  EXPECT_EQ(std::filesystem::file_size(file), 8U);
}

TEST_F(Recorder, MissingFolderIsNamed) {
  const std::filesystem::path nowhere = folder.path() / "no" / "such.take";
  const std::string error =
      storage_error([&] { const TakeRecorder recorder(test::recorder_config(nowhere)); });
  EXPECT_THAT(error, HasSubstr(nowhere.string()));
  EXPECT_THAT(error, HasSubstr("create its folder"));
}

TEST_F(Recorder, DiskBelowTheReserveStartsNoTake) {
  TakeRecorderConfig config = test::recorder_config(file);
  config.disk_reserve_bytes = 1ULL << 62;
  EXPECT_THAT(storage_error([&] { const TakeRecorder recorder(config); }), HasSubstr("nearly full"));
  EXPECT_FALSE(std::filesystem::exists(file)) << "a failed start left a file behind";
}

TEST_F(Recorder, FullQueueDropsAndCounts) {
  TakeRecorderConfig config = test::recorder_config(file);
  config.when_full = WhenFull::Drop;
  config.queue_frames = 4;
  TakeRecorder recorder(config);
  // Not started: nothing empties the queue.
  for (std::uint64_t index = 0; index < 6; ++index) {
    EXPECT_EQ(recorder.record(test::take_frame(index, subject)), index < 4);
  }
  recorder.start();
  const RecorderStatus status = recorder.stop();
  EXPECT_EQ(status.frames, 4U);
  EXPECT_EQ(status.dropped, 2U);
  EXPECT_EQ(TakeReader(file).info().dropped, 2U);
}

TEST_F(Recorder, WaitingCallerLosesNothing) {
  TakeRecorderConfig config = test::recorder_config(file);
  config.queue_frames = 2;
  TakeRecorder recorder(config);
  recorder.start();
  for (std::uint64_t index = 0; index < 150; ++index) {
    ASSERT_TRUE(recorder.record(test::take_frame(index, subject)));
  }
  EXPECT_EQ(recorder.stop().frames, 150U);
}

TEST_F(Recorder, AMeshThatNoReaderWouldAcceptEndsTheTakeWithAdvice) {
  auto too_big = std::make_shared<mesh::Subject>(*subject);
  too_big->id = 1;
  too_big->identity.resize(5000);
  TakeRecorder recorder(test::recorder_config(file));
  recorder.start();
  recorder.record(test::take_frame(0, subject));
  recorder.record(test::take_frame(1, too_big));
  const RecorderStatus status = recorder.stop();
  EXPECT_EQ(status.state, RecorderState::Failed);
  EXPECT_THAT(status.reason, HasSubstr("use a smaller model"));
  TakeReader reader(file);
  EXPECT_TRUE(reader.info().closed);
  EXPECT_EQ(reader.info().end_reason, status.reason);
  EXPECT_EQ(static_cast<std::uint64_t>(reader.frame_count()), status.frames);
}

TEST_F(Recorder, FramesAfterTheStopAreNotTaken) {
  TakeRecorder recorder(test::recorder_config(file));
  recorder.start();
  recorder.request_stop();
  EXPECT_FALSE(recorder.record(test::take_frame(0, subject)));
  recorder.stop();
  EXPECT_EQ(recorder.stop().frames, 0U);
  EXPECT_EQ(recorder.status().dropped, 0U) << "a frame after the end is no loss";
}

TEST_F(Recorder, NeverStartedRecorderLeavesAnEmptyClosedTake) {
  { const TakeRecorder recorder(test::recorder_config(file)); }
  TakeReader reader(file);
  EXPECT_EQ(reader.frame_count(), 0);
  EXPECT_TRUE(reader.info().closed);
}

TEST_F(Recorder, TakeIsReadableWhileItIsRecorded) {
  TakeRecorder recorder(test::recorder_config(file));
  recorder.start();
  std::uint64_t index = 0;
  while (recorder.status().frames < 5) {
    recorder.record(test::take_frame(index++, subject));
    std::this_thread::sleep_for(5ms);
  }
  {
    TakeReader reader(file);
    EXPECT_FALSE(reader.info().closed);
    ASSERT_GE(reader.frame_count(), 5);
    EXPECT_EQ(reader.frame(3)->sequence, 3U);
    recorder.record(test::take_frame(index++, subject));
    // The open reader keeps the log from being folded in; the take must not suffer from it.
    const RecorderStatus status = recorder.stop();
    EXPECT_EQ(status.state, RecorderState::Finished);
    EXPECT_EQ(status.frames, index);
  }
  TakeReader reader(file);
  EXPECT_EQ(reader.frame_count(), static_cast<std::int64_t>(index));
  EXPECT_TRUE(reader.info().closed);
}

TEST_F(Recorder, NamesAreCheckedAndNeverReused) {
  EXPECT_EQ(take_path(folder.path(), "take 1"), folder.path() / "take 1.take");
  for (const std::string& name : {std::string(), std::string("a/b"), std::string(".hidden"),
                                  std::string("a\nb"), std::string(101, 'x'), std::string("..")}) {
    try {
      take_path(folder.path(), name);
      ADD_FAILURE() << "accepted: " << name;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
    }
  }
  std::ofstream(folder.path() / "one.take") << "x";
  EXPECT_THAT(storage_error([&] { take_path(folder.path(), "one"); }), HasSubstr("exists already"));

  const auto time = std::chrono::system_clock::from_time_t(0);
  EXPECT_EQ(default_take_name(folder.path(), time), "1970-01-01T00-00-00Z");
  std::ofstream(folder.path() / "1970-01-01T00-00-00Z.take") << "x";
  EXPECT_EQ(default_take_name(folder.path(), time), "1970-01-01T00-00-00Z-2");
}

std::int64_t monotonic_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

/// Runs `work` in a child process and gives its wait status.
class Child {
 public:
  explicit Child(auto&& work) : pid_(::fork()) {
    if (pid_ == 0) {
      work();
      ::_exit(0);
    }
  }
  void kill() const { ::kill(pid_, SIGKILL); }
  int wait() const {
    int status = 0;
    ::waitpid(pid_, &status, 0);
    return status;
  }

 private:
  pid_t pid_;
};

TEST_F(Recorder, KilledProcessLosesOneSecondAtMost) {
  int ends[2] = {};
  ASSERT_EQ(::pipe(ends), 0);
  const Child child([&] {
    TakeRecorder recorder(test::recorder_config(file));
    recorder.start();
    for (std::uint64_t index = 0;; ++index) {
      auto frame = std::make_shared<mesh::MeshFrame>(*test::take_frame(index, subject));
      frame->timestamp_ns = monotonic_ns();
      recorder.record(frame);
      if (::write(ends[1], &frame->timestamp_ns, sizeof(frame->timestamp_ns)) < 0) {
        ::_exit(1);
      }
      std::this_thread::sleep_for(5ms);
    }
  });
  ::close(ends[1]);
  std::int64_t first_ns = 0;
  std::int64_t recorded_ns = 0;
  do {
    ASSERT_EQ(::read(ends[0], &recorded_ns, sizeof(recorded_ns)), static_cast<ssize_t>(sizeof(recorded_ns)));
    first_ns = first_ns == 0 ? recorded_ns : first_ns;
  } while (recorded_ns - first_ns < 2'200'000'000);
  child.kill();
  child.wait();
  ::close(ends[0]);

  TakeReader reader(file);
  EXPECT_FALSE(reader.info().closed);
  ASSERT_GT(reader.frame_count(), 0);
  EXPECT_LE(recorded_ns - reader.info().last_timestamp_ns, 1'000'000'000);
  for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
    EXPECT_EQ(reader.frame(index)->sequence, static_cast<std::uint64_t>(index));
  }
}

/// Records `frames` frames in a process that is killed once they are committed.
void record_and_be_killed(const TakeRecorderConfig& config, std::uint64_t frames,
                          const std::shared_ptr<const mesh::Subject>& subject) {
  const Child child([&] {
    TakeRecorder recorder(config);
    recorder.start();
    for (std::uint64_t index = 0; index < frames; ++index) {
      recorder.record(test::take_frame(index, subject));
    }
    while (recorder.status().frames < frames) {
      std::this_thread::sleep_for(1ms);
    }
    ::raise(SIGKILL);
  });
  const int status = child.wait();
  ASSERT_TRUE(WIFSIGNALED(status));
}

std::int64_t files_in(const std::filesystem::path& folder) {
  return std::distance(std::filesystem::directory_iterator(folder), std::filesystem::directory_iterator());
}

TEST_F(Recorder, LogThatAReaderKeptIsFoldedInLater) {
  TakeRecorder recorder(test::recorder_config(file));
  std::optional<Database> reader(std::in_place, file, Database::Mode::ReadOnly);
  reader->execute("BEGIN");
  EXPECT_EQ(reader->query_int64("SELECT count(*) FROM frame"), 0);  // from here on it sees this state
  recorder.start();
  for (std::uint64_t index = 0; index < 12; ++index) {
    recorder.record(test::take_frame(index, subject));
  }
  const RecorderStatus status = recorder.stop();
  EXPECT_EQ(status.state, RecorderState::Finished);
  EXPECT_TRUE(status.log_left);
  EXPECT_GT(log_bytes(file), 0U);
  const ClosedTake read = close_take(file);
  EXPECT_THAT(read.left, AllOf(HasSubstr("-wal file"), HasSubstr("another program")));
  EXPECT_TRUE(read.info.closed);

  reader.reset();
  const ClosedTake closed = close_take(file);
  EXPECT_THAT(closed.left, IsEmpty());
  EXPECT_FALSE(closed.recovered);
  EXPECT_THAT(closed.info.end_reason, IsEmpty()) << "it was not broken off";
  EXPECT_EQ(closed.info.frame_count, 12);
  EXPECT_EQ(files_in(folder.path()), 1);
}

/// A reader that is open at the end without reading keeps the log's mode, though nothing is in the log.
TEST_F(Recorder, CompleteTakeInTheLogsModeIsReadFromAReadOnlyFolder) {
  TakeRecorder recorder(test::recorder_config(file));
  std::optional<Database> reader(std::in_place, file, Database::Mode::ReadOnly);
  EXPECT_EQ(reader->query_int64("SELECT count(*) FROM frame"), 0);
  recorder.start();
  recorder.record(test::take_frame(0, subject));
  EXPECT_FALSE(recorder.stop().log_left);
  reader.reset();
  const std::filesystem::path archive = folder.path() / "50 % of #1?";
  std::filesystem::create_directory(archive);
  std::filesystem::copy(file, archive / "one.take");
  ASSERT_EQ(::chmod(folder.path().c_str(), 0755) | ::chmod(archive.c_str(), 0555), 0);
  const bool root = ::geteuid() == 0;
  ASSERT_TRUE(!root || ::seteuid(65534) == 0);  // root may write everywhere
  std::string refused;
  std::int64_t frames = 0;
  try {
    TakeReader archived(archive / "one.take");
    frames = archived.frame_count();
    EXPECT_EQ(archived.frame(0)->sequence, 0U);
  } catch (const Error& error) {
    refused = error.what();
  }
  ASSERT_TRUE(!root || ::seteuid(0) == 0);
  EXPECT_EQ(::chmod(archive.c_str(), 0755), 0);
  EXPECT_THAT(refused, IsEmpty());
  EXPECT_EQ(frames, 1);
  EXPECT_EQ(files_in(archive), 1);

  // Where its folder can be written the mode is left for good.
  EXPECT_EQ(Database(file, Database::Mode::ReadOnly).query_int64("SELECT count(*) FROM frame"), 1);
  EXPECT_THAT(close_take(file).left, IsEmpty());
  EXPECT_FALSE(std::filesystem::exists(file.string() + "-wal"));
  EXPECT_FALSE(std::filesystem::exists(file.string() + "-shm"));
}

TEST_F(Recorder, BrokenOffTakeIsClosedAndSaysSo) {
  record_and_be_killed(test::recorder_config(file), 30, subject);
  EXPECT_FALSE(TakeReader(file).info().closed);
  const ClosedTake closed = close_take(file);
  EXPECT_THAT(closed.left, IsEmpty());
  EXPECT_TRUE(closed.recovered);
  EXPECT_TRUE(closed.info.closed);
  EXPECT_THAT(closed.info.end_reason, HasSubstr("broken off"));
  EXPECT_EQ(closed.info.frame_count, 30);
  EXPECT_EQ(files_in(folder.path()), 1);
  EXPECT_EQ(TakeReader(file).frame(29)->sequence, 29U);
  EXPECT_FALSE(close_take(file).recovered) << "once is enough";
}

TEST_F(Recorder, BrokenOffTakeThatIsReadStaysAsItIs) {
  record_and_be_killed(test::recorder_config(file), 3, subject);
  Database reader(file, Database::Mode::ReadOnly);
  reader.query_int64("SELECT count(*) FROM frame");
  const ClosedTake read = close_take(file);
  EXPECT_FALSE(read.recovered);
  EXPECT_FALSE(read.info.closed);
  EXPECT_THAT(read.left, AllOf(HasSubstr("not closed"), HasSubstr("another program")));
}

/// The other process sees nothing of whoever tries to close its take, and loses nothing.
TEST_F(Recorder, TakeThatAnotherProcessRecordsIsNotTouched) {
  int begun[2] = {};
  int end[2] = {};
  ASSERT_EQ(::pipe(begun) | ::pipe(end), 0);
  const Child child([&] {
    ::close(end[1]);
    TakeRecorder recorder(test::recorder_config(file));
    recorder.start();
    pollfd ended{end[0], POLLIN, 0};
    std::uint64_t index = 0;
    for (; ::poll(&ended, 1, 2) == 0; ++index) {
      recorder.record(test::take_frame(index, subject));
      if (index == 0 && ::write(begun[1], "x", 1) != 1) {
        ::_exit(1);
      }
    }
    const RecorderStatus status = recorder.stop();
    ::_exit(status.state == RecorderState::Finished && status.frames == index && !status.log_left ? 0 : 2);
  });
  ::close(begun[1]);
  ::close(end[0]);
  char byte = 0;
  ASSERT_EQ(::read(begun[0], &byte, 1), 1);
  for (int attempt = 0; attempt < 8; ++attempt) {  // over several commits
    const ClosedTake recorded = close_take(file);
    EXPECT_FALSE(recorded.recovered);
    EXPECT_FALSE(recorded.info.closed);
    EXPECT_THAT(recorded.left, HasSubstr("another program records"));
  }
  ::close(end[1]);
  const int status = child.wait();
  ::close(begun[0]);
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  const TakeInfo info = close_take(file).info;
  EXPECT_TRUE(info.closed);
  EXPECT_THAT(info.end_reason, IsEmpty());
  EXPECT_GT(info.frame_count, 100);
  EXPECT_EQ(files_in(folder.path()), 1);
}

TEST_F(Recorder, TakeThatThisProcessRecordsIsNotTouched) {
  TakeRecorder recorder(test::recorder_config(file));
  recorder.start();
  recorder.record(test::take_frame(0, subject));
  EXPECT_THAT(close_take(file).left, HasSubstr("another program records"));
  recorder.record(test::take_frame(1, subject));
  EXPECT_EQ(recorder.stop().frames, 2U);
  EXPECT_THAT(close_take(file).info.end_reason, IsEmpty());
}

/// Records until the recorder fails. The exit status tells what went wrong.
void record_until_failure(const TakeRecorderConfig& config,
                          const std::shared_ptr<const mesh::Subject>& subject) {
  try {
    TakeRecorder recorder(config);
    recorder.start();
    for (std::uint64_t index = 0; recorder.status().state == RecorderState::Recording; ++index) {
      if (index > 200'000) {
        ::_exit(2);
      }
      recorder.record(test::take_frame(index, subject));
      // The disk must last for more than one commit.
      std::this_thread::sleep_for(5ms);
    }
    const RecorderStatus status = recorder.stop();
    ::_exit(status.state == RecorderState::Failed && !status.reason.empty() && status.dropped > 0 ? 0 : 3);
  } catch (const std::exception&) {
    ::_exit(4);
  }
}

void expect_readable(const std::filesystem::path& file) {
  TakeReader reader(file);
  ASSERT_GT(reader.frame_count(), 0);
  for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
    ASSERT_EQ(reader.frame(index)->sequence, static_cast<std::uint64_t>(index));
  }
}

TEST_F(Recorder, FileSizeLimitStopsTheRecordingAndKeepsTheTake) {
  // A file size limit makes writes fail as a full disk does, without a disk of its own.
  const Child child([&] {
    ::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{4U << 20, 4U << 20};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    record_until_failure(test::recorder_config(file), subject);
  });
  const int status = child.wait();
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  expect_readable(file);
}

TEST_F(Recorder, FullDiskStopsTheRecordingAndKeepsTheTake) {
  const test::SmallDisk disk(folder.path() / "disk");
  if (!disk.mounted()) {
    GTEST_SKIP() << "mounting a small tmpfs needs root";
  }
  const std::filesystem::path take = folder.path() / "disk" / "full.take";
  const Child child([&] { record_until_failure(test::recorder_config(take), subject); });
  const int status = child.wait();
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  expect_readable(take);
}

TEST_F(Recorder, ReserveStopsTheRecordingInTimeToCloseIt) {
  const test::SmallDisk disk(folder.path() / "disk");
  if (!disk.mounted()) {
    GTEST_SKIP() << "mounting a small tmpfs needs root";
  }
  TakeRecorderConfig config = test::recorder_config(folder.path() / "disk" / "reserve.take");
  config.disk_reserve_bytes = 3U << 20;
  const auto small = test::patch_subject(5, 3, 1);
  TakeRecorder recorder(config);
  recorder.start();
  for (std::uint64_t index = 0; recorder.status().state == RecorderState::Recording; ++index) {
    recorder.record(test::take_frame(index, small));
    std::this_thread::sleep_for(1ms);
  }
  const RecorderStatus status = recorder.stop();
  EXPECT_EQ(status.state, RecorderState::Failed);
  EXPECT_THAT(status.reason, HasSubstr("reserve"));
  TakeReader reader(config.file);
  EXPECT_TRUE(reader.info().closed);
  EXPECT_THAT(reader.info().end_reason, HasSubstr("reserve"));
  EXPECT_EQ(reader.frame_count(), static_cast<std::int64_t>(status.frames));
}

/// Records pictures until some are committed, does something to the files, and goes on until the recorder has
/// failed or committed many more.
RecorderStatus record_while(const std::filesystem::path& file, const std::function<void()>& harm) {
  TakeRecorder recorder(test::picture_config(file));
  recorder.start();
  std::uint64_t slot = 0;
  const auto record_to = [&](std::uint64_t committed) {
    while (recorder.status().state == RecorderState::Recording && recorder.status().frames < committed) {
      recorder.record(test::picture_frame(slot++));
      std::this_thread::sleep_for(2ms);
    }
  };
  record_to(10);
  harm();
  record_to(recorder.status().frames + 300);
  return recorder.stop();
}

TEST_F(Recorder, ATakeThatIsNoLongerThereIsNeverFinished) {
  namespace fs = std::filesystem;
  const fs::path takes = folder.path() / "takes";
  const fs::path elsewhere = folder.path() / "elsewhere";
  const fs::path one = takes / "one.take";
  const fs::path pictures = takes / "one.frames";
  const auto move_folder = [&] {
    fs::rename(takes, elsewhere);
    fs::create_directory(takes);
  };
  const auto replace = [&] {
    fs::remove(one);
    std::ofstream(one) << "of somebody else";
  };
  const std::pair<std::function<void()>, fs::path> harms[] = {
      {[&] { fs::remove(one); }, one},
      {[&] { fs::remove(one.string() + "-wal"); }, one},
      {[&] { fs::remove_all(pictures); }, pictures},
      {[&] { fs::rename(one, takes / "two.take"); }, one},
      {move_folder, one},
      {replace, one}};
  for (const auto& [harm, named] : harms) {
    fs::create_directory(takes);
    const RecorderStatus status = record_while(one, harm);
    EXPECT_EQ(status.state, RecorderState::Failed);
    EXPECT_THAT(status.reason, AllOf(HasSubstr(named.string()), HasSubstr("no longer there")));
    EXPECT_GT(status.dropped, 0U);
    fs::remove_all(takes);
    fs::remove_all(elsewhere);
  }
}

TEST_F(Recorder, ATakeThatGoesJustBeforeItsEndIsNeverFinished) {
  for (const bool picture : {false, true}) {
    const std::filesystem::path one = folder.path() / (picture ? "p.take" : "t.take");
    TakeRecorder recorder(test::picture_config(one));
    recorder.start();
    while (recorder.status().frames == 0) {
      recorder.record(test::picture_frame(0));
      std::this_thread::sleep_for(2ms);
    }
    std::filesystem::remove(picture ? folder.path() / "p.frames" / "000001.seg" : one);
    const RecorderStatus status = recorder.stop();
    EXPECT_EQ(status.state, RecorderState::Failed);
    EXPECT_THAT(status.reason, HasSubstr("no longer there"));
  }
}

TEST_F(Recorder, ASegmentThatWasCutOffIsTold) {
  TakeRecorder recorder(test::picture_config(file, 1));  // a segment for each frame
  recorder.start();
  for (std::uint64_t slot = 0; recorder.status().frames < 3; ++slot) {
    recorder.record(test::picture_frame(slot));
    std::this_thread::sleep_for(2ms);
  }
  std::filesystem::resize_file(folder.path() / "one.frames" / "000001.seg", 100);
  const RecorderStatus status = recorder.stop();
  EXPECT_EQ(status.state, RecorderState::Failed);
  EXPECT_THAT(status.reason, AllOf(HasSubstr("000001.seg"), HasSubstr("cut off")));
}

/// From the n-th sync of the end on the disk gives errors: nobody is told that all is well.
TEST_F(Recorder, AFailedSyncOfTheEndIsTold) {
  int told = 0;
  for (int n = 1;; ++n) {
    file = folder.path() / (std::to_string(n) + ".take");
    TakeRecorder recorder(test::picture_config(file));
    recorder.start();
    for (std::uint64_t slot = 0; slot < 20; ++slot) {
      recorder.record(test::picture_frame(slot));
    }
    while (recorder.status().queued > 0) {
      std::this_thread::sleep_for(1ms);
    }
    std::atomic<int> syncs{0};
    test::decide_syncs([&](const std::string&) { return ++syncs < n; });
    const RecorderStatus status = recorder.stop();
    test::decide_syncs(nullptr);
    if (syncs < n) {
      EXPECT_EQ(status.state, RecorderState::Finished);
      EXPECT_THAT(status.warning, IsEmpty());
      break;
    }
    const bool failed = status.state == RecorderState::Failed;
    EXPECT_THAT(failed ? status.reason : status.warning,
                failed ? HasSubstr("cannot") : HasSubstr("not known to be on the disk"))
        << "sync " << n;
    told += failed ? 0 : 1;
    // The next start closes it, and what was told to be there is there.
    close_take(file);
    TakeReader reader(file);
    EXPECT_GE(reader.frame_count(), static_cast<std::int64_t>(status.frames)) << "sync " << n;
  }
  EXPECT_GT(told, 1) << "syncs of the log's end";
}

/// On a slow disk each may take seconds.
TEST_F(Recorder, SyncsLittle) {
  std::atomic<int> syncs{0};
  test::hook_syncs([&](const std::string&) { ++syncs; });
  TakeRecorder recorder(test::picture_config(file));
  recorder.start();
  EXPECT_LE(syncs.exchange(0), 2) << "the new file and the folder with its name";
  while (recorder.status().frames == 0) {
    recorder.record(test::picture_frame(0));
    std::this_thread::sleep_for(2ms);
  }
  syncs = 0;
  recorder.record(test::picture_frame(1));
  EXPECT_EQ(recorder.stop().state, RecorderState::Finished);
  EXPECT_LE(syncs, 6) << "pictures, log, log and file as it is folded in, file as the log is left";
  test::hook_syncs(nullptr);
}

TEST_F(Recorder, WaitsForWhoHoldsTheLockForAMoment) {
  for (const bool patient : {true, false}) {
    TakeRecorderConfig config = test::recorder_config(folder.path() / (patient ? "p.take" : "i.take"));
    config.lock_patience = patient ? 1h : 0ms;
    TakeRecorder recorder(config);
    recorder.start();
    Database backup(config.file, Database::Mode::ReadWrite);
    backup.execute("BEGIN IMMEDIATE");
    recorder.record(test::take_frame(0, subject));
    if (patient) {
      std::this_thread::sleep_for(50ms);  // for the lock to be met; it does not matter where it is not
      backup.execute("ROLLBACK");
    } else {
      while (recorder.status().state == RecorderState::Recording) {
        std::this_thread::sleep_for(1ms);
      }
      backup.execute("ROLLBACK");
    }
    const RecorderStatus status = recorder.stop();
    EXPECT_EQ(status.state, patient ? RecorderState::Finished : RecorderState::Failed);
    EXPECT_THAT(status.reason, patient ? HasSubstr("") : HasSubstr("locked"));
    EXPECT_EQ(status.frames, patient ? 1U : 0U);
  }
}

TEST_F(Recorder, WithoutAThreadThereIsNoTake) {
#ifdef FACET_SANITIZED
  GTEST_SKIP() << "the sanitizer makes the threads";
#endif
  TakeRecorderConfig config = test::picture_config(file);
  config.pack_threads = 3;
  for (int n = 1; n <= 4; ++n) {
    TakeRecorder recorder(config);
    test::refuse_thread(n);
    std::string error;
    try {
      recorder.start();
    } catch (const Error& refused) {
      error = refused.what();
    }
    test::refuse_thread(0);
    EXPECT_THAT(error, AllOf(HasSubstr(file.string()), HasSubstr("no thread"))) << n;
    EXPECT_FALSE(recorder.record(test::picture_frame(0)));
    EXPECT_EQ(recorder.stop().state, RecorderState::Failed);
    EXPECT_EQ(files_in(folder.path()), 0) << n;
  }
  EXPECT_EQ(test::record_pictures(config, 5).state, RecorderState::Finished);
}

TEST_F(Recorder, TheReasonOfTheEndIsInTheTake) {
  TakeRecorder recorder(test::recorder_config(file));
  recorder.start();
  recorder.record(test::take_frame(0, subject));
  recorder.request_stop("the source is at its end");
  recorder.request_stop("somebody asked, later");
  const RecorderStatus status = recorder.stop();
  EXPECT_TRUE(recorder.ended());
  EXPECT_EQ(status.state, RecorderState::Finished);
  EXPECT_EQ(status.reason, "the source is at its end");
  EXPECT_EQ(TakeReader(file).info().end_reason, status.reason);
}

TEST_F(Recorder, GoesOnWhereNoDescriptorIsLeft) {
  const Child child([&] {
    TakeRecorder recorder(test::picture_config(file, 1));  // a segment for each frame
    recorder.start();
    while (::dup(0) >= 0) {
    }
    for (std::uint64_t slot = 0; slot < 20; ++slot) {
      recorder.record(test::picture_frame(slot));
    }
    const RecorderStatus status = recorder.stop();
    ::_exit(status.state == RecorderState::Finished && status.frames == 20 && status.warning.empty() ? 0 : 2);
  });
  EXPECT_EQ(child.wait(), 0);
  EXPECT_EQ(TakeReader(file).info().segments.size(), 20U);
}

}  // namespace
}  // namespace facet::take
