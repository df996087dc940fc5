// Takes with pictures: records, segments, what becomes of them when something breaks.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <ctime>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <mutex>
#include <optional>
#include <thread>

#include "facet/error.hpp"
#include "record_take.hpp"
#include "support/failing_disk.hpp"
#include "support/paths.hpp"
#include "support/small_disk.hpp"
#include "system_calls.hpp"
#include "take/checksum.hpp"
#include "take/picture_records.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"
#include "take/segment.hpp"

namespace facet::take {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
namespace fs = std::filesystem;

std::string error_of(auto&& work) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput) << error.what();
    return error.what();
  }
  return "";
}

TEST(Checksum, IsCrc32c) {
  const std::string digits = "123456789";
  const std::span text(reinterpret_cast<const std::uint8_t*>(digits.data()), digits.size());
  EXPECT_EQ(crc32c(text), 0xE3069283U);  // the check value of the catalogues
  const std::vector<std::uint8_t> zeros(32, 0);
  EXPECT_EQ(crc32c(zeros), 0x8A9136AAU);  // RFC 3720, B.4
  std::mt19937 random(7);
  std::vector<std::uint8_t> bytes(200);
  std::generate(bytes.begin(), bytes.end(), [&] { return static_cast<std::uint8_t>(random()); });
  for (std::size_t begin = 0; begin < 9; ++begin) {
    for (std::size_t size = 0; begin + size <= bytes.size(); ++size) {
      const auto part = std::span(bytes).subspan(begin, size);
      ASSERT_EQ(crc32c(part), crc32c_by_table(part)) << begin << " " << size;
    }
  }
}

/// One set of one picture, written and read.
bool survives(const Frame& picture) {
  FrameSet set;
  set.slot = 77;
  set.frames = {Frame(), picture};
  set.missing = 1;
  std::vector<std::uint8_t> records;
  PictureWriter().append(set, 5, records);
  FrameSet got = set;
  got.frames[1].pixels = nullptr;
  got.frames[1].stride_bytes = 4 * static_cast<std::size_t>(picture.width_px);
  PictureReader().read(records, 5, got);
  return got.frames[0].empty() && test::same_picture(got.frames[1], picture);
}

TEST(Records, EverySizeAndContentComesBackBitByBit) {
  for (const auto& [width_px, height_px] :
       {std::pair(1, 1), {1, 9}, {9, 1}, {13, 127}, {64, 48}, {640, 480}}) {
    for (const bool grey : {false, true}) {
      for (const std::uint32_t seed : {1U, 2U, 3U}) {
        EXPECT_TRUE(survives(test::noisy_picture(width_px, height_px, grey, seed)))
            << width_px << "x" << height_px << (grey ? " grey" : " colour") << " seed " << seed;
      }
    }
  }
  Frame plain = test::noisy_picture(50, 40, true, 1);
  for (const std::uint8_t value : {std::uint8_t{0}, std::uint8_t{255}}) {
    auto pixels = std::make_shared<std::uint8_t[]>(plain.stride_bytes * 40, value);
    for (std::size_t alpha = 3; alpha < plain.stride_bytes * 40; alpha += 4) {
      pixels.get()[alpha] = 255;
    }
    plain.pixels = std::move(pixels);
    EXPECT_TRUE(survives(plain));
  }
}

TEST(Records, OneColouredPixelMakesAColourPicture) {
  Frame picture = test::noisy_picture(33, 21, true, 4);
  const std::size_t bytes = picture.stride_bytes * 21;
  auto pixels = std::make_shared<std::uint8_t[]>(bytes);
  std::copy_n(picture.pixels.get(), bytes, pixels.get());
  pixels.get()[20 * picture.stride_bytes + 4 * 32 + 2] ^= 1;
  picture.pixels = std::move(pixels);
  EXPECT_TRUE(survives(picture));
}

TEST(Records, DamageIsNoticedAndNeverShown) {
  constexpr unsigned kSeed = 4711;
  std::mt19937 random(kSeed);
  const FrameSet sent = *test::picture_frame(3)->images;
  std::vector<std::uint8_t> sound;
  PictureWriter().append(sent, 3, sound);
  FrameSet described = sent;
  for (Frame& frame : described.frames) {
    frame.pixels = nullptr;
    frame.stride_bytes = 4 * static_cast<std::size_t>(frame.width_px);
  }
  PictureReader reader;
  int refused = 0;
  for (int round = 0; round < 2000; ++round) {
    std::vector<std::uint8_t> records = sound;
    if (round % 4 == 0) {
      records.resize(random() % records.size());
    } else {
      records[random() % records.size()] ^= static_cast<std::uint8_t>(1U << (random() % 8));
    }
    FrameSet got = described;
    try {
      reader.read(records, 3, got);
      // What was cut or flipped belonged to no picture that is there: whole records missing, or padding.
      for (std::size_t camera = 0; camera < got.frames.size(); ++camera) {
        EXPECT_TRUE(got.frames[camera].empty() ||
                    test::same_picture(got.frames[camera], sent.frames[camera]));
      }
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      ++refused;
    }
  }
  EXPECT_GT(refused, 1900) << "seed " << kSeed;
  EXPECT_THAT(error_of([&] {
                FrameSet got = described;
                reader.read(sound, 4, got);
              }),
              HasSubstr("of frame 3 stands here"));
  EXPECT_THAT(error_of([&] {
                FrameSet got = described;
                got.frames[0].width_px += 1;
                reader.read(sound, 3, got);
              }),
              AllOf(HasSubstr("camera one"), HasSubstr("another size")));
}

class PictureTake : public testing::Test {
 protected:
  ~PictureTake() override { test::hook_syncs(nullptr); }

  test::TemporaryFolder folder;
  fs::path file = folder.path() / "one.take";

  fs::path segment(int number) const {
    return folder.path() / "one.frames" / fmt::format("{:06}.seg", number);
  }
  void expect_sound(std::int64_t count) const {
    TakeReader reader(file);
    ASSERT_EQ(reader.frame_count(), count);
    for (std::int64_t index = 0; index < count; ++index) {
      const auto frame = reader.frame(index);
      ASSERT_NE(frame->images, nullptr);
      ASSERT_TRUE(test::same_pictures(*frame->images)) << index;
    }
  }
};

constexpr std::uint64_t kSmallSegment = 20'000;  // about eight of the tests' frames

TEST_F(PictureTake, ComeBackBitByBit) {
  const RecorderStatus status = test::record_pictures(test::picture_config(file), 30);
  EXPECT_EQ(status.state, RecorderState::Finished);
  EXPECT_EQ(status.frames, 30U);
  EXPECT_EQ(status.dropped, 0U);
  expect_sound(30);
  const TakeReader reader(file);
  ASSERT_EQ(reader.info().segments.size(), 1U);
  EXPECT_EQ(reader.info().segments[0].file, segment(1));
  EXPECT_EQ(reader.info().segments[0].frame_count, 30);
  EXPECT_EQ(reader.info().file_bytes, fs::file_size(file) + fs::file_size(segment(1)));
  EXPECT_GE(status.bytes, reader.info().segments[0].bytes);
}

TEST_F(PictureTake, EveryNumberOfThreadsWritesTheSameTake) {
  std::vector<std::string> written;
  for (const int threads : {1, 3}) {
    file = folder.path() / fmt::format("{}.take", threads);
    TakeRecorderConfig config = test::picture_config(file);
    config.pack_threads = threads;
    EXPECT_EQ(test::record_pictures(config, 40).frames, 40U);
    expect_sound(40);
    std::ifstream stream(folder.path() / fmt::format("{}.frames/000001.seg", threads), std::ios::binary);
    std::string bytes{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
    written.push_back(bytes.substr(64));  // the head names the take
  }
  EXPECT_TRUE(written[0] == written[1]);
}

TEST_F(PictureTake, DescribedOnesHaveNoPixels) {
  test::record_pictures(test::picture_config(file), 3);
  fs::remove_all(folder.path() / "one.frames");
  TakeReader reader(file);
  const auto images = reader.frame(1, Pictures::Described)->images;
  ASSERT_NE(images, nullptr);
  EXPECT_EQ(images->frames[1].width_px, 39);
  EXPECT_TRUE(images->frames[1].empty());
}

TEST_F(PictureTake, AreCutIntoSegments) {
  constexpr std::uint64_t kSlots = 65 * 60;  // 65 s at 60 a second
  constexpr std::uint64_t kBytes = 3'000'000;
  ASSERT_EQ(test::record_pictures(test::picture_config(file, kBytes), kSlots).frames, kSlots);
  TakeReader reader(file);
  const std::vector<TakeSegment>& segments = reader.info().segments;
  ASSERT_GT(segments.size(), 2U);
  std::int64_t next = 0;
  for (const TakeSegment& part : segments) {
    EXPECT_EQ(part.fault, "");
    EXPECT_EQ(part.first_frame, next);
    EXPECT_EQ(part.last_frame, part.first_frame + part.frame_count - 1);
    EXPECT_LE(fs::file_size(part.file), kBytes);
    next = part.last_frame + 1;
  }
  EXPECT_EQ(next, static_cast<std::int64_t>(kSlots));
  for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
    const auto frame = reader.frame(index);
    ASSERT_EQ(frame->sequence, static_cast<std::uint64_t>(index));
    ASSERT_TRUE(test::same_pictures(*frame->images)) << index;
  }
}

TEST_F(PictureTake, AFrameLongerThanASegmentHasOneForItself) {
  test::record_pictures(test::picture_config(file, 1), 3);
  EXPECT_EQ(TakeReader(file).info().segments.size(), 3U);
  expect_sound(3);
}

TEST_F(PictureTake, MissingSegmentIsNamedAndTheRestIsRead) {
  test::record_pictures(test::picture_config(file, kSmallSegment), 40);
  fs::remove(segment(2));
  TakeReader reader(file);
  const TakeSegment lost = reader.info().segments.at(1);
  EXPECT_THAT(lost.fault, AllOf(HasSubstr(segment(2).string()), HasSubstr("missing")));
  EXPECT_THAT(reader.info().segments.at(0).fault, IsEmpty());
  for (std::int64_t index = 0; index < 40; ++index) {
    const bool is_lost = index >= lost.first_frame && index <= lost.last_frame;
    const std::string error =
        error_of([&] { EXPECT_TRUE(test::same_pictures(*reader.frame(index)->images)); });
    if (is_lost) {
      EXPECT_THAT(error, AllOf(HasSubstr(file.string()), HasSubstr(fmt::format("frame {}:", index)),
                               HasSubstr(segment(2).string()), HasSubstr("missing")));
    } else {
      EXPECT_EQ(error, "");
    }
    EXPECT_EQ(reader.frame(index, Pictures::Described)->sequence, static_cast<std::uint64_t>(index));
  }
}

TEST_F(PictureTake, CutSegmentIsReadUpToTheCut) {
  test::record_pictures(test::picture_config(file), 40);
  fs::resize_file(segment(1), fs::file_size(segment(1)) / 2);
  TakeReader reader(file);
  EXPECT_THAT(reader.info().segments.at(0).fault, HasSubstr("the rest is lost"));
  int sound = 0;
  int lost = 0;
  for (std::int64_t index = 0; index < 40; ++index) {
    const std::string error =
        error_of([&] { sound += test::same_pictures(*reader.frame(index)->images) ? 1 : 0; });
    lost += error.empty() ? 0 : 1;
    EXPECT_TRUE(error.empty() || lost > 0) << "a sound frame after the cut";
    if (!error.empty()) {
      EXPECT_THAT(error, AllOf(HasSubstr(fmt::format("frame {}:", index)), HasSubstr("ends at byte")));
    }
  }
  EXPECT_NEAR(sound, 20, 2);
  EXPECT_EQ(sound + lost, 40);
}

TEST_F(PictureTake, DamagedPictureIsNamedAndTheRestIsRead) {
  test::record_pictures(test::picture_config(file), 10);
  const auto size = fs::file_size(segment(1));
  std::fstream stream(segment(1), std::ios::in | std::ios::out | std::ios::binary);
  stream.seekp(static_cast<std::streamoff>(size / 2));
  stream.put('\x5A').put('\xA5').put('\x5A').put('\xA5');
  stream.close();
  TakeReader reader(file);
  int lost = 0;
  for (std::int64_t index = 0; index < 10; ++index) {
    const std::string error =
        error_of([&] { EXPECT_TRUE(test::same_pictures(*reader.frame(index)->images)); });
    if (!error.empty()) {
      ++lost;
      EXPECT_THAT(error, AllOf(HasSubstr(fmt::format("frame {}:", index)), HasSubstr(segment(1).string()),
                               HasSubstr("checksum")));
    }
  }
  EXPECT_EQ(lost, 1);
}

TEST_F(PictureTake, SegmentOfAnotherTakeIsNoticed) {
  test::record_pictures(test::picture_config(file, kSmallSegment), 30);
  const fs::path other = folder.path() / "two.take";
  test::record_pictures(test::picture_config(other, kSmallSegment), 30);
  fs::copy_file(folder.path() / "two.frames/000001.seg", segment(1), fs::copy_options::overwrite_existing);
  EXPECT_THAT(TakeReader(file).info().segments.at(0).fault, HasSubstr("another take"));
  EXPECT_THAT(error_of([&] { TakeReader(file).frame(0); }), HasSubstr("another take"));
  fs::copy_file(segment(3), segment(2), fs::copy_options::overwrite_existing);
  EXPECT_THAT(TakeReader(file).info().segments.at(1).fault, HasSubstr("another number"));
  std::ofstream(segment(3)) << std::string(200, 'x');
  EXPECT_THAT(TakeReader(file).info().segments.at(2).fault, HasSubstr("no segment"));
  fs::remove(segment(3));
  fs::create_directory(segment(3));
  EXPECT_THAT(TakeReader(file).info().segments.at(2).fault, HasSubstr("not a file"));
}

TEST_F(PictureTake, TakeIsMovedWithItsFolder) {
  test::record_pictures(test::picture_config(file), 5);
  const fs::path elsewhere = folder.path() / "archive";
  fs::create_directory(elsewhere);
  fs::rename(file, elsewhere / "two.take");
  EXPECT_THAT(TakeReader(elsewhere / "two.take").info().segments.at(0).fault, HasSubstr("two.frames"));
  fs::rename(folder.path() / "one.frames", elsewhere / "two.frames");
  file = elsewhere / "two.take";
  expect_sound(5);
}

TEST_F(PictureTake, ANameWhoseFolderIsThereIsTaken) {
  fs::create_directory(folder.path() / "one.frames");
  EXPECT_THROW(take_path(folder.path(), "one"), Error);
  EXPECT_EQ(free_take_name(folder.path(), "one"), "one-2");
  try {
    const TakeRecorder recorder(test::picture_config(file));
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_THAT(error.what(), AllOf(HasSubstr("one.frames"), HasSubstr("exists already")));
  }
  EXPECT_FALSE(fs::exists(file)) << "a failed start left a file behind";
}

TEST_F(PictureTake, TakeWithoutAnyHasNoFolder) {
  TakeRecorder recorder(test::picture_config(file));
  recorder.start();
  recorder.record(std::make_shared<mesh::MeshFrame>(test::searching_frame(0)));
  recorder.stop();
  EXPECT_FALSE(fs::exists(folder.path() / "one.frames"));
  EXPECT_EQ(TakeReader(file).frame(0)->images, nullptr);
}

TEST_F(PictureTake, TooLargeOnesAreLeftOutAndTheFrameSaysSo) {
  auto frame = std::make_shared<mesh::MeshFrame>(*test::picture_frame(0));
  auto set = std::make_shared<FrameSet>(*frame->images);
  set->frames[0] = test::noisy_picture(16385, 1, true, 1);
  frame->images = set;
  TakeRecorder recorder(test::picture_config(file));
  recorder.start();
  recorder.record(frame);
  recorder.record(test::picture_frame(1));
  EXPECT_EQ(recorder.stop().frames, 2U);
  TakeReader reader(file);
  EXPECT_TRUE(reader.frame(0)->degraded);
  EXPECT_THAT(reader.frame(0)->degraded_reason, HasSubstr("too large"));
  EXPECT_TRUE(test::same_pictures(*reader.frame(1)->images));
}

TEST_F(PictureTake, AreReadWhileTheyAreRecorded) {
  TakeRecorder recorder(test::picture_config(file, kSmallSegment));
  recorder.start();
  std::uint64_t slot = 0;
  const auto record_until = [&](std::uint64_t committed) {
    while (recorder.status().frames < committed) {
      recorder.record(test::picture_frame(slot++));
      std::this_thread::sleep_for(2ms);
    }
  };
  record_until(20);
  TakeReader reader(file);
  EXPECT_FALSE(reader.info().closed);
  for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
    ASSERT_TRUE(test::same_pictures(*reader.frame(index)->images)) << index;
  }
  record_until(static_cast<std::uint64_t>(reader.frame_count()) + 20);
  EXPECT_TRUE(test::same_pictures(*reader.frame(reader.frame_count() - 1)->images));
  recorder.stop();
  expect_sound(static_cast<std::int64_t>(slot));
}

/// The index must never name what a power cut could still take: whenever the log of the index is synced, all
/// that lies in the segments has been synced before.
TEST_F(PictureTake, AreOnTheDiskBeforeTheirIndex) {
  std::mutex mutex;
  std::map<std::string, std::uintmax_t> synced;  // guarded by mutex, as the counters
  int commits = 0;
  int unsafe = 0;
  const fs::path pictures = folder.path() / "one.frames";
  test::hook_syncs([&](const std::string& path) {
    const std::lock_guard lock(mutex);
    if (path.ends_with(".seg")) {
      synced[path] = fs::file_size(path);
    } else if (path == pictures.string()) {
      synced[path] = 1;
    } else if (path.ends_with("-wal") && fs::exists(pictures)) {
      ++commits;
      for (const auto& entry : fs::directory_iterator(pictures)) {
        const bool safe = synced.contains(entry.path().string()) &&
                          synced[entry.path().string()] == entry.file_size() &&
                          synced.contains(pictures.string());
        unsafe += safe ? 0 : 1;
      }
    }
  });
  TakeRecorder recorder(test::picture_config(file, kSmallSegment));
  recorder.start();
  for (std::uint64_t slot = 0; recorder.status().frames < 150; ++slot) {
    recorder.record(test::picture_frame(slot));
    std::this_thread::sleep_for(5ms);
  }
  recorder.stop();
  EXPECT_GT(commits, 2);
  EXPECT_EQ(unsafe, 0);
  EXPECT_GT(synced.size(), 3U);
}

/// The disk stands still until the test lets it go on: record() returns meanwhile, the frames that fit into
/// the queue are kept, the others counted.
TEST_F(PictureTake, SlowDiskDropsAndCountsAndBlocksNobody) {
  std::mutex mutex;
  std::condition_variable changed;
  bool stands = false;  // guarded by mutex
  bool go_on = false;   // guarded by mutex
  test::hook_syncs([&](const std::string& path) {
    std::unique_lock lock(mutex);
    if (path.ends_with(".seg") && !stands) {
      stands = true;
      changed.notify_all();
      changed.wait(lock, [&] { return go_on; });
    }
  });
  TakeRecorderConfig config = test::picture_config(file);
  config.when_full = WhenFull::Drop;
  config.queue_frames = 8;
  TakeRecorder recorder(config);
  recorder.start();
  std::uint64_t slot = 0;
  std::uint64_t recorded = 0;
  while (true) {
    recorded += recorder.record(test::picture_frame(slot++)) ? 1 : 0;
    const std::lock_guard lock(mutex);
    if (stands) {
      break;
    }
    std::this_thread::sleep_for(1ms);
  }
  for (int i = 0; i < 40; ++i) {
    recorded += recorder.record(test::picture_frame(slot++)) ? 1 : 0;
  }
  EXPECT_GE(recorder.status().dropped, 32U) << "queue of 8";
  EXPECT_EQ(recorder.status().queued, 8U);
  {
    const std::lock_guard lock(mutex);
    go_on = true;
    changed.notify_all();
  }
  const RecorderStatus status = recorder.stop();
  EXPECT_EQ(status.state, RecorderState::Finished);
  EXPECT_EQ(status.frames, recorded);
  EXPECT_EQ(status.frames + status.dropped, slot);
  TakeReader reader(file);
  EXPECT_EQ(reader.info().dropped, status.dropped);
  ASSERT_EQ(reader.frame_count(), static_cast<std::int64_t>(recorded));
  for (std::int64_t index = 0; index < reader.frame_count(); ++index) {
    ASSERT_TRUE(test::same_pictures(*reader.frame(index)->images)) << index;
  }
}

TEST_F(PictureTake, TheirBuffersGoBackWhileTheDiskStands) {
  std::mutex mutex;
  std::condition_variable changed;
  bool go_on = false;  // guarded by mutex
  test::hook_syncs([&](const std::string& path) {
    std::unique_lock lock(mutex);
    changed.wait(lock, [&] { return go_on || !path.ends_with(".seg"); });
  });
  TakeRecorderConfig config = test::picture_config(file);
  config.queue_frames = 32;
  TakeRecorder recorder(config);
  recorder.start();
  std::vector<std::weak_ptr<const mesh::MeshFrame>> frames;
  for (std::uint64_t slot = 0; slot < 32; ++slot) {
    auto frame = test::picture_frame(slot);
    frames.push_back(frame);
    recorder.record(std::move(frame));
  }
  // Without an end where a frame is held: the test's limit of time finds that.
  while (std::any_of(frames.begin(), frames.end(), [](const auto& frame) { return !frame.expired(); })) {
    std::this_thread::sleep_for(1ms);
  }
  {
    const std::lock_guard lock(mutex);
    go_on = true;
    changed.notify_all();
  }
  EXPECT_EQ(recorder.stop().frames, 32U);
  expect_sound(32);
}

std::int64_t monotonic_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

/// The wait status of a child process that does `work`, after `meanwhile`, which knows its id.
int child(const std::function<void()>& work, const std::function<void(pid_t)>& meanwhile = {}) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    work();
    ::_exit(0);
  }
  if (meanwhile) {
    meanwhile(pid);
  }
  int status = 0;
  ::waitpid(pid, &status, 0);
  return status;
}

TEST_F(PictureTake, KilledProcessLosesOneSecondAtMost) {
  int ends[2] = {};
  ASSERT_EQ(::pipe(ends), 0);
  std::int64_t recorded_ns = 0;
  child(
      [&] {
        TakeRecorder recorder(test::picture_config(file, kSmallSegment));
        recorder.start();
        for (std::uint64_t slot = 0;; ++slot) {
          auto frame = std::make_shared<mesh::MeshFrame>(*test::picture_frame(slot));
          frame->timestamp_ns = monotonic_ns();
          recorder.record(frame);
          if (::write(ends[1], &frame->timestamp_ns, sizeof(frame->timestamp_ns)) < 0) {
            ::_exit(1);
          }
          std::this_thread::sleep_for(5ms);
        }
      },
      [&](pid_t pid) {
        ::close(ends[1]);
        std::int64_t first_ns = 0;
        while (recorded_ns - first_ns < 2'200'000'000 || first_ns == 0) {
          if (::read(ends[0], &recorded_ns, sizeof(recorded_ns)) <= 0) {
            break;
          }
          first_ns = first_ns == 0 ? recorded_ns : first_ns;
        }
        ::kill(pid, SIGKILL);
      });
  ::close(ends[0]);
  const TakeInfo info = TakeReader(file).info();
  EXPECT_FALSE(info.closed);
  ASSERT_GT(info.frame_count, 100);
  EXPECT_GT(info.segments.size(), 2U);
  EXPECT_LE(recorded_ns - info.last_timestamp_ns, 1'000'000'000);
  expect_sound(info.frame_count);
}

/// Records until the recorder fails. The exit status tells what went wrong.
void record_until_failure(const TakeRecorderConfig& config) {
  try {
    TakeRecorder recorder(config);
    recorder.start();
    for (std::uint64_t slot = 0; recorder.status().state == RecorderState::Recording; ++slot) {
      if (slot > 100'000) {
        ::_exit(2);
      }
      recorder.record(test::picture_frame(slot));
      std::this_thread::sleep_for(1ms);
    }
    const RecorderStatus status = recorder.stop();
    ::_exit(status.state == RecorderState::Failed && !status.reason.empty() && status.dropped > 0 ? 0 : 3);
  } catch (const std::exception&) {
    ::_exit(4);
  }
}

TEST_F(PictureTake, SegmentThatCanGrowNoFurtherStopsTheRecordingAndKeepsTheTake) {
  const int status = child([&] {
    ::signal(SIGXFSZ, SIG_IGN);
    const rlimit limit{2U << 20, 2U << 20};
    ::setrlimit(RLIMIT_FSIZE, &limit);
    record_until_failure(test::picture_config(file));
  });
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  const TakeInfo info = TakeReader(file).info();
  EXPECT_TRUE(info.closed);
  EXPECT_THAT(info.end_reason, HasSubstr("cannot write"));
  ASSERT_GT(info.frame_count, 0);
  expect_sound(info.frame_count);
  // What the index does not know of was cut off.
  EXPECT_EQ(fs::file_size(segment(1)), 64 + info.segments.at(0).bytes);
}

TEST(Segments, KeepWhatWasSyncedWhicheverCallOfTheDiskFails) {
  for (std::int64_t n = 1;; ++n) {
    const test::TemporaryFolder folder;
    const fs::path take = folder.path() / "one.take";
    const TakeId id = new_take_id();
    std::vector<Extent> synced;
    std::optional<test::FailingDisk> disk(n);
    try {
      SegmentWriter writer(take, id, 2500);
      std::vector<Extent> appended;
      for (std::uint8_t i = 1; i <= 9; ++i) {
        appended.push_back(writer.append(std::vector<std::uint8_t>(1000, i)));
        if (i % 3 == 0) {
          writer.sync();
          synced = appended;
        }
      }
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Storage);
      EXPECT_THAT(error.what(), HasSubstr(segments_folder(take).string())) << "call " << n;
    }
    const bool failed = disk->has_failed();
    disk.reset();
    EXPECT_EQ(fs::exists(segments_folder(take)), !synced.empty() || fs::exists(segment_file(take, 1)));
    SegmentReader reader(take, id);
    for (std::size_t i = 0; i < synced.size(); ++i) {
      EXPECT_THAT(reader.read(synced[i]), testing::Each(i + 1)) << "call " << n;
    }
    if (!failed) {
      EXPECT_EQ(synced.size(), 9U);
      EXPECT_EQ(synced.back().segment, 5);
      EXPECT_GT(n, 30);
      break;
    }
  }
}

TEST_F(PictureTake, FullDiskStopsTheRecordingAndKeepsTheTake) {
  const test::SmallDisk disk(folder.path() / "disk");
  if (!disk.mounted()) {
    GTEST_SKIP() << "mounting a small tmpfs needs root";
  }
  file = folder.path() / "disk" / "full.take";
  const int status = child([&] { record_until_failure(test::picture_config(file)); });
  ASSERT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  const std::int64_t count = TakeReader(file).frame_count();
  ASSERT_GT(count, 0);
  expect_sound(count);
}

}  // namespace
}  // namespace facet::take
