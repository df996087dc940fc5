#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include "camera/factory.hpp"
#include "facet/error.hpp"
#include "support/paths.hpp"

namespace facet::camera {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;
constexpr auto kPatience = 5s;

/// Makes videos with the ffmpeg program; the tests that need one skip where it is missing.
class VideoFileTest : public testing::Test {
 protected:
  void SetUp() override {
    if (std::system("command -v ffmpeg >/dev/null 2>&1") != 0) {
      GTEST_SKIP() << "the ffmpeg program is not installed";
    }
  }

  std::filesystem::path make(const std::string& name, const std::string& arguments) {
    const std::filesystem::path file = folder_.path() / name;
    const std::string command = fmt::format("ffmpeg -nostdin -v error -y {} '{}'", arguments, file.string());
    EXPECT_EQ(std::system(command.c_str()), 0) << command;
    return file;
  }

  static std::unique_ptr<Camera> started(const std::filesystem::path& file, bool paced = false,
                                         bool loop = false) {
    auto camera = open_camera({.kind = "file", .path = file, .paced = paced, .loop = loop});
    camera->start();
    return camera;
  }

  static std::vector<Frame> all_frames(Camera& camera) {
    std::vector<Frame> frames;
    for (Frame frame; camera.next(frame, kPatience) == CaptureOutcome::Delivered;) {
      frames.push_back(frame);
    }
    return frames;
  }

  test::TemporaryFolder folder_;
};

std::array<int, 3> pixel(const Frame& frame, int x, int y) {
  const std::uint8_t* at = frame.row(y) + 4 * x;
  return {at[0], at[1], at[2]};
}

void expect_near(std::array<int, 3> got, std::array<int, 3> want, int tolerance) {
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(got[i], want[i], tolerance) << "channel " << i;
  }
}

// (ffmpeg draws it in YUV: colours come within 3.) Left half red, right half blue, lower quarter green.
constexpr const char* kFlag =
    "-f lavfi -i color=red:s=64x48:r=25:d={} -vf "
    "drawbox=x=32:y=0:w=32:h=48:color=blue:t=fill,drawbox=x=0:y=36:w=64:h=12:color=lime:t=fill";

TEST_F(VideoFileTest, DeliversEveryFrameOfAFileInOrderWithItsTimes) {
  const auto file = make("flag.mkv", fmt::format(fmt::runtime(kFlag), 2) + " -c:v ffv1 -pix_fmt bgr0");
  auto camera = started(file);
  EXPECT_EQ(camera->info().width_px, 64);
  EXPECT_EQ(camera->info().height_px, 48);
  EXPECT_DOUBLE_EQ(camera->info().rate_hz, 25);
  EXPECT_FALSE(camera->info().live);
  EXPECT_EQ(camera->status().state, CameraState::Opening);
  const auto frames = all_frames(*camera);
  ASSERT_EQ(frames.size(), 50U);
  EXPECT_EQ(camera->status().state, CameraState::Ended);
  EXPECT_EQ(camera->status().counters.delivered, 50U);
  EXPECT_EQ(camera->status().counters.skipped, 0U);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(frames[i].sequence, i);
    EXPECT_NEAR(static_cast<double>(frames[i].media_time_ns), 40e6 * static_cast<double>(i), 1e6);
    EXPECT_FALSE(frames[i].corrupt);
  }
  expect_near(pixel(frames[0], 10, 10), {255, 0, 0}, 3);
  expect_near(pixel(frames[0], 50, 10), {0, 0, 255}, 3);
  expect_near(pixel(frames[0], 50, 42), {0, 255, 0}, 3);
  EXPECT_EQ(frames[0].row(0)[3], 255);
  EXPECT_EQ(camera->last_error(), "");
}

TEST_F(VideoFileTest, ConvertsColoursByTheStreamsOwnMatrixAndRange) {
  // The same colour through both matrices, both ranges, 8 and 10 bits must come back the same.
  for (const char* colours : {"bt709", "smpte170m"}) {
    for (const char* range : {"tv", "pc"}) {
      for (const char* format : {"yuv444p", "yuv420p10le"}) {
        const auto file = make(fmt::format("{}-{}-{}.mkv", colours, range, format),
                               fmt::format("-f lavfi -i color=0xC08060:s=64x64:r=25:d=0.2 -vf "
                                           "scale=out_color_matrix={0}:out_range={1},format={2} "
                                           "-colorspace {0} -color_range {1} -c:v ffv1",
                                           colours, range, format));
        const auto frames = all_frames(*started(file));
        ASSERT_FALSE(frames.empty());
        SCOPED_TRACE(fmt::format("{} {} {}", colours, range, format));
        expect_near(pixel(frames[0], 30, 30), {0xC0, 0x80, 0x60}, 3);
      }
    }
  }
}

TEST_F(VideoFileTest, AppliesRotationMetadataAsTheFfmpegPlayerDoes) {
  const auto upright = make("upright.mp4", fmt::format(fmt::runtime(kFlag), 1) + " -c:v mpeg4 -q:v 1");
  for (const int degrees : {90, 180, 270}) {
    SCOPED_TRACE(degrees);
    const auto rotated =
        make(fmt::format("rotated-{}.mp4", degrees),
             fmt::format("-i '{}' -c copy -metadata:s:v:0 rotate={}", upright.string(), degrees));
    const auto truth = all_frames(
        *started(make(fmt::format("{}.png", degrees), fmt::format("-i '{}' -frames:v 1", rotated.string()))));
    const auto frames = all_frames(*started(rotated));
    ASSERT_FALSE(truth.empty());
    ASSERT_FALSE(frames.empty());
    ASSERT_EQ(frames[0].width_px, degrees == 180 ? 64 : 48);
    ASSERT_EQ(frames[0].width_px, truth[0].width_px);
    ASSERT_EQ(frames[0].height_px, truth[0].height_px);
    for (const auto& [x, y] : {std::pair{3, 3}, {44, 3}, {3, 44}, {44, 44}, {20, 10}, {30, 20}}) {
      SCOPED_TRACE(fmt::format("at {}, {}", x, y));
      expect_near(pixel(frames[0], x, y), pixel(truth[0], x, y), 12);  // mpeg4's chroma is at half resolution
    }
  }
}

TEST_F(VideoFileTest, ReadsGreyOddTinyAndHugePictures) {
  for (const auto& [size, format] :
       {std::pair{"16x16", "gray"}, {"97x61", "yuv444p"}, {"7680x4320", "gray"}}) {
    const auto file =
        make(fmt::format("{}.mkv", size),
             fmt::format("-f lavfi -i color=gray:s=64x64:r=5:d=0.4 -vf scale={},setsar=1,format={} -c:v ffv1",
                         size, format));
    const auto frames = all_frames(*started(file));
    ASSERT_EQ(frames.size(), 2U) << size;
    EXPECT_EQ(fmt::format("{}x{}", frames[0].width_px, frames[0].height_px), size);
    const auto grey = pixel(frames[0], frames[0].width_px - 1, frames[0].height_px - 1);
    expect_near(grey, {128, 128, 128}, 4);
  }
}

TEST_F(VideoFileTest, ReadsAPictureAsOneFrame) {
  const auto frames =
      all_frames(*started(make("one.png", fmt::format(fmt::runtime(kFlag), 1) + " -frames:v 1")));
  ASSERT_EQ(frames.size(), 1U);
  expect_near(pixel(frames[0], 10, 10), {255, 0, 0}, 3);
}

TEST_F(VideoFileTest, PacedFileKeepsTimeAndSkipsWhatASlowReaderMisses) {
  const auto file = make("paced.mkv", "-f lavfi -i testsrc=s=64x48:r=50:d=2 -c:v ffv1");
  auto camera = started(file, true);
  EXPECT_TRUE(camera->info().live);
  Frame first;
  ASSERT_EQ(camera->next(first, kPatience), CaptureOutcome::Delivered);
  std::this_thread::sleep_for(400ms);
  Frame late;
  ASSERT_EQ(camera->next(late, kPatience), CaptureOutcome::Delivered);
  EXPECT_GE(late.sequence,
            first.sequence + 15);  // 20 frames were due in the pause; slack and slow machines allowed for
  EXPECT_EQ(late.timestamp_ns - first.timestamp_ns, late.media_time_ns - first.media_time_ns);
  Frame none;
  EXPECT_NE(camera->next(none, 0ms), CaptureOutcome::Failed);
  camera->stop();
  EXPECT_EQ(camera->next(none, 0ms), CaptureOutcome::EndOfStream);
}

TEST_F(VideoFileTest, PacedFileThatCannotBeDecodedInTimeRunsSlower) {
  const auto file = make("slow.mkv", "-f lavfi -i testsrc2=s=1280x720:r=1000:d=0.3 -c:v ffv1");
  auto camera = started(file, true);
  std::vector<Frame> frames;
  Frame frame;
  const auto begun = std::chrono::steady_clock::now();
  while (camera->next(frame, kPatience) == CaptureOutcome::Delivered) {
    EXPECT_TRUE(frames.empty() || frame.timestamp_ns > frames.back().timestamp_ns);
    frames.push_back(frame);
  }
  const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - begun;
  if (seconds.count() < 0.45) {
    GTEST_SKIP() << "decoded nearly in time: 300 pictures in " << seconds.count() << " s";
  }
  // Without a limit all are skipped after the first.
  EXPECT_GE(static_cast<double>(frames.size()), seconds.count() / 0.3) << seconds.count() << " s";
}

TEST_F(VideoFileTest, LoopedFileGoesOnCounting) {
  const auto file = make("loop.mp4", "-f lavfi -i testsrc=s=64x48:r=25:d=0.4 -c:v mpeg4 -bf 2");
  auto camera = started(file, false, true);
  Frame frame;
  std::int64_t last_ns = -1;
  for (std::uint64_t i = 0; i < 35; ++i) {
    ASSERT_EQ(camera->next(frame, kPatience), CaptureOutcome::Delivered) << camera->last_error();
    EXPECT_EQ(frame.sequence, i);
    EXPECT_GT(frame.media_time_ns, last_ns);
    last_ns = frame.media_time_ns;
  }
}

TEST_F(VideoFileTest, DeliveredPixelsStayWhileTheCameraGoesOnAndAfterItIsGone) {
  auto camera = started(make("count.mkv", "-f lavfi -i testsrc=s=64x48:r=25:d=1 -c:v ffv1"));
  Frame kept;
  ASSERT_EQ(camera->next(kept, kPatience), CaptureOutcome::Delivered);
  const std::vector<std::uint8_t> copy(kept.row(0), kept.row(0) + kept.stride_bytes * 48);
  all_frames(*camera);
  camera.reset();
  EXPECT_TRUE(std::equal(copy.begin(), copy.end(), kept.row(0)));
}

TEST_F(VideoFileTest, TruncatedFileGivesWhatItHoldsAndSaysSo) {
  const auto whole = make("whole.mkv", "-f lavfi -i testsrc=s=320x240:r=25:d=4 -c:v ffv1");
  const auto cut = folder_.path() / "cut.mkv";
  std::filesystem::copy_file(whole, cut);
  std::filesystem::resize_file(cut, std::filesystem::file_size(whole) / 2);
  auto camera = started(cut);
  const auto frames = all_frames(*camera);
  EXPECT_GT(frames.size(), 20U);
  EXPECT_LT(frames.size(), 100U);
  EXPECT_THAT(camera->last_error(), HasSubstr("cut.mkv"));
}

TEST_F(VideoFileTest, FewerFramesThanTheContainerCountsAreNoTruncation) {
  // Cut without encoding anew: frames before the cut stay in the file, and an edit list hides them.
  const auto whole = make("whole.mp4", "-f lavfi -i testsrc=s=64x48:r=25:d=4 -c:v mpeg4 -g 100");
  const auto cut = make("cut.mp4", fmt::format("-ss 1.3 -i {} -c copy", whole.string()));
  // Every frame at first, then every fourth.
  const auto varying = make("varying.mkv",
                            "-f lavfi -i testsrc=s=64x48:r=25:d=4 -vf \"select='lt(n,20)+not(mod(n,4))'\" "
                            "-vsync vfr -c:v mpeg4");
  for (const auto& file : {cut, varying}) {
    auto camera = started(file);
    ASSERT_TRUE(camera->info().frame_count.has_value());
    EXPECT_LT(all_frames(*camera).size() + 1, *camera->info().frame_count) << file;
    EXPECT_EQ(camera->last_error(), "");
  }
}

TEST_F(VideoFileTest, SoundThatOutlastsThePictureIsNoTruncation) {
  const std::string sound = "-f lavfi -i sine=d=3 -c:a flac ";
  const auto whole = make("sound.mkv", "-f lavfi -i testsrc=s=320x240:r=25:d=2 " + sound + "-c:v mpeg4");
  auto camera = started(whole);
  EXPECT_EQ(camera->info().frame_count, 50U);
  EXPECT_EQ(all_frames(*camera).size(), 50U);
  EXPECT_EQ(camera->last_error(), "");
  // Cut short it still is one.
  const auto cut = folder_.path() / "cut-sound.mkv";
  std::filesystem::copy_file(whole, cut);
  std::filesystem::resize_file(cut, std::filesystem::file_size(whole) / 2);
  camera = started(cut);
  EXPECT_LT(all_frames(*camera).size(), 49U);
  EXPECT_THAT(camera->last_error(), HasSubstr("cut-sound.mkv"));
}

TEST_F(VideoFileTest, DamagedPacketsCostTheirFramesOnly) {
  const auto file = make("damaged.mkv", "-f lavfi -i testsrc=s=320x240:r=25:d=4 -c:v mpeg4");
  {
    std::fstream bytes(file, std::ios::in | std::ios::out | std::ios::binary);
    const auto size = std::filesystem::file_size(file);
    for (std::uintmax_t at = size / 3; at < size / 3 + 2000; ++at) {
      bytes.seekp(static_cast<std::streamoff>(at));
      bytes.put(static_cast<char>(at * 37));
    }
  }
  auto camera = started(file);
  EXPECT_GT(all_frames(*camera).size(), 50U);
}

TEST_F(VideoFileTest, SaysWhatIsWrongWithAFileThatHoldsNoVideo) {
  const auto expect_error = [](const std::filesystem::path& file, const char* what) {
    try {
      started(file);
      FAIL() << file << " was accepted";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      EXPECT_THAT(error.what(), HasSubstr(file.filename().string()));
      EXPECT_THAT(error.what(), HasSubstr(what));
    }
  };
  expect_error(folder_.path() / "missing.mp4", "no such file");
  expect_error(folder_.path(), "folder");
  const auto empty = folder_.path() / "empty.mp4";
  std::ofstream(empty).flush();
  expect_error(empty, "empty");
  const auto noise = folder_.path() / "noise.mp4";
  std::ofstream(noise) << std::string(5000, 'x');
  expect_error(noise, "video");
  const auto sound = make("sound.wav", "-f lavfi -i sine=d=0.2");
  expect_error(sound, "no video stream");
  const auto whole = make("moov.mp4", "-f lavfi -i testsrc=s=64x48:r=25:d=1 -c:v mpeg4");
  std::filesystem::resize_file(whole, std::filesystem::file_size(whole) / 2);
  expect_error(whole, "is the file complete");
}

TEST(CameraFactory, RefusesAnUnknownKind) {
  EXPECT_THROW(open_camera({.kind = "telepathy"}), Error);
}

}  // namespace
}  // namespace facet::camera
