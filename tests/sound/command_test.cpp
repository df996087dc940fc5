// `facet summary` and `facet export` of a take with sound and timecode.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "render/video_writer.hpp"
#include "sound/flac_file.hpp"
#include "sound/sound_file.hpp"
#include "support/child_process.hpp"
#include "support/mesh_frames.hpp"
#include "support/paths.hpp"
#include "support/videos.hpp"
#include "take/recorder.hpp"

namespace facet::sound {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr double kRate_hz = 48009.6;  // 200 ppm
constexpr std::int64_t kFirst_ns = 90'000'000'000;

/// Frames at 25 Hz from a second after the sound's beginning on, each 40 ms; the first two without a mesh. A
/// click at each tenth frame.
class TakeWithSound : public testing::Test {
 protected:
  std::int64_t time_of(int frame) const { return kFirst_ns + 1'000'000'000 + frame * 40'000'000LL; }

  void SetUp() override {
    std::vector<std::int32_t> samples(static_cast<std::size_t>(5 * kRate_hz), 0);
    for (int frame = 0; frame < 75; frame += 10) {
      const double place = static_cast<double>(time_of(frame) - kFirst_ns) * 1e-9 * kRate_hz;
      samples[static_cast<std::size_t>(std::lround(place))] = 1 << 22;
    }
    const std::int64_t count = static_cast<std::int64_t>(samples.size());
    SoundFile sound({file("a.flac"), {48000, 1, 24}, 0});
    sound.start();
    sound.add(samples);
    sound.stop();
    take::TakeRecorderConfig config;
    config.file = file("a.take");
    config.when_full = take::WhenFull::Wait;
    config.disk_reserve_bytes = 0;
    config.more_meta = [count] {
      take::TakeTimecode timecode;
      timecode.source = take::TimecodeSource::Ltc;
      timecode.rate = {25, false, false};
      timecode.spans = {{kFirst_ns, kFirst_ns + 3'000'000'000, 90'000, 4e7}};
      take::MetaEntries entries = take::to_meta(timecode);
      const auto more = take::to_meta(take::TakeSound{kFirst_ns, kRate_hz, 48000, count, 0, ""});
      entries.insert(entries.end(), more.begin(), more.end());
      return entries;
    };
    take::TakeRecorder recorder(config);
    recorder.start();
    const auto subject = test::patch_subject();
    const auto albedo = test::patch_albedo(*subject);
    for (int i = 0; i < 75; ++i) {
      auto frame = i < 2 ? test::searching_frame(static_cast<std::uint64_t>(i))
                         : test::patch_frame(static_cast<std::uint64_t>(i), subject, albedo);
      frame.timestamp_ns = time_of(i);
      frame.media_time_ns = i * 40'000'000LL;
      recorder.record(std::make_shared<mesh::MeshFrame>(frame));
    }
    ASSERT_EQ(recorder.stop().frames, 75U);
  }

  std::string file(const std::string& name) const { return (folder_.path() / name).string(); }
  int run(const std::vector<std::string>& arguments) {
    test::ChildProcess child(FACET_PROGRAM, arguments, folder_.path() / "log");
    const int status = child.wait();
    output_ = child.output();
    return status;
  }
  std::vector<std::string> lines_of(const std::string& name) const {
    std::ifstream in(file(name));
    std::vector<std::string> lines;
    for (std::string line; std::getline(in, line);) {
      lines.push_back(line);
    }
    return lines;
  }

  test::TemporaryFolder folder_;
  std::string output_;
};

TEST_F(TakeWithSound, IsExportedSoThatItLiesUnderTheAnimation) {
  ASSERT_EQ(run({"export", file("a.take"), "--format", "flac", "-o", file("b.flac")}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("140160 samples at 48000 Hz, 2.920 s; sample 0 is at frame 2"));
  FlacReader reader(file("b.flac"));
  FlacReader::Block block;
  std::vector<std::int32_t> samples;
  while (reader.next(block)) {
    samples.insert(samples.end(), block.samples.begin(), block.samples.end());
  }
  ASSERT_EQ(samples.size(), 140'160U);
  for (int frame = 10; frame < 75; frame += 10) {
    const auto near = samples.begin() + (frame - 2) * 1920;
    const auto loudest = std::max_element(near - 100, near + 100);
    EXPECT_NEAR(static_cast<double>(loudest - near), 0, 1) << frame;
    EXPECT_GT(*loudest, 1 << 21) << frame;
  }
  // A part, as a Broadcast Wave.
  ASSERT_EQ(run({"export", file("a.take"), "--format", "wav", "--frames", "10:35", "-o", file("b.wav")}), 0)
      << output_;
  std::ifstream wav(file("b.wav"), std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(wav)), {});
  EXPECT_EQ(bytes.size(), 20U + 602 + 32 + 3 * 48'000);
  EXPECT_EQ(bytes.substr(12, 4), "bext");
  EXPECT_EQ(run({"export", file("a.take"), "--format", "wav", "-o", file("none/of/it/b.wav")}), 0) << output_;
}

TEST_F(TakeWithSound, SaysItsTimecode) {
  ASSERT_EQ(run({"summary", file("a.take")}), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("timecode      from 01:00:01:00, LTC at 25 frames per second, 1 span\n"));
  EXPECT_THAT(output_,
              HasSubstr("sound         5.0 s at 48000 Hz (+200.0 ppm), from 1.000 s before the first"));
  ASSERT_EQ(run({"export", file("a.take"), "--format", "csv", "-o", file("b.csv")}), 0) << output_;
  const auto curves = lines_of("b.csv");
  ASSERT_EQ(curves.size(), 76U);
  EXPECT_EQ(curves[1].substr(0, 16), "01:00:01:00.000,");
  EXPECT_EQ(curves[75].substr(0, 16), "01:00:03:24.000,");  // counted on
  ASSERT_EQ(run({"export", file("a.take"), "--format", "jsonl", "-o", file("b.jsonl")}), 0) << output_;
  const auto signals = lines_of("b.jsonl");
  EXPECT_EQ(nlohmann::json::parse(signals.at(7))["timecode"], "01:00:01:07");
  EXPECT_EQ(nlohmann::json::parse(signals.at(74))["timecode"], nullptr);
}

/// Animations begin at the first frame with a mesh, number 2.
TEST_F(TakeWithSound, AnimationsSayWhereTheyBegin) {
  ASSERT_EQ(run({"export", file("a.take"), "--format", "glb-frames", "-o", file("b.glb")}), 0) << output_;
  std::ifstream glb(file("b.glb"), std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(glb)), {});
  std::uint32_t length = 0;
  std::memcpy(&length, bytes.data() + 12, sizeof(length));
  const auto document = nlohmann::json::parse(bytes.substr(20, length));
  EXPECT_EQ(document["asset"]["version"], "2.0");
  EXPECT_EQ(document["asset"]["extras"]["timecode"], "01:00:01:02");
  EXPECT_EQ(document["asset"]["extras"]["timecodeRate"], "25");
  ASSERT_EQ(
      run({"export", file("a.take"), "--format", "usda-frames", "--frames", "10:35", "-o", file("b.usda")}),
      0)
      << output_;
  std::ifstream usda(file("b.usda"));
  const std::string text((std::istreambuf_iterator<char>(usda)), {});
  EXPECT_THAT(text, HasSubstr("    customLayerData = {\n        string timecode = \"01:00:01:10\"\n"
                              "        string timecodeRate = \"25\"\n    }\n)\n"));
  EXPECT_THAT(text, HasSubstr("    startTimeCode = 10\n"));
}

/// Somebody else's reader: a film's stream as raw values.
std::string decoded(const std::string& film, const std::vector<std::string>& how, const std::string& out) {
  std::vector<std::string> arguments = {"-v", "error", "-i", film};
  arguments.insert(arguments.end(), how.begin(), how.end());
  arguments.push_back(out);
  test::ChildProcess ffmpeg("/usr/bin/ffmpeg", arguments, out + ".log");
  EXPECT_EQ(ffmpeg.wait(), 0) << ffmpeg.output();
  std::ifstream stream(out, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// The source's picture flashes where its sound clicks, at each tenth frame: so does the film.
TEST_F(TakeWithSound, AFilmsPictureAndSoundAreTogether) {
  {
    render::VideoWriter source(file("source.mkv"), 1280, 720, 25);
    for (int i = 0; i < 75; ++i) {
      const auto grey = static_cast<std::uint8_t>(i % 10 == 0 ? 230 : 30);
      source.append(render::plain_picture(1280, 720, {grey, grey, grey}));
    }
    source.finish();
  }
  ASSERT_EQ(run({"export", file("a.take"), "--format", "mp4", "--panels", "picture,skin", "--video",
                 file("source.mkv"), "--size", "120", "--frames", "5:", "-o", file("a.mp4")}),
            0)
      << output_;
  EXPECT_THAT(output_, HasSubstr("192x148 px, 2.80 s at 25 Hz, with sound, timecode from 01:00:01:05"));
  const std::string pictures =
      decoded(file("a.mp4"), {"-vf", "crop=96:120:0:0,scale=1:1:flags=area,format=gray", "-f", "rawvideo"},
              file("p"));
  const std::string sound = decoded(file("a.mp4"), {"-ac", "1", "-f", "f32le"}, file("s"));
  ASSERT_EQ(pictures.size(), 70U);
  std::vector<float> samples(sound.size() / sizeof(float));
  std::memcpy(samples.data(), sound.data(), samples.size() * sizeof(float));
  ASSERT_NEAR(static_cast<double>(samples.size()), 2.8 * 48000, 2048) << "AAC's last piece is filled up";
  for (int frame = 10; frame < 75; frame += 10) {
    const int shown = frame - 5;
    EXPECT_GT(static_cast<unsigned char>(pictures[static_cast<std::size_t>(shown)]), 180) << frame;
    EXPECT_LT(static_cast<unsigned char>(pictures[static_cast<std::size_t>(shown - 1)]), 80) << frame;
    const auto near = samples.begin() + shown * 1920;
    const auto loudest = std::max_element(near - 4000, near + 4000,
                                          [](float a, float b) { return std::abs(a) < std::abs(b); });
    EXPECT_NEAR(static_cast<double>(loudest - near), 0, 100) << "2 ms, at frame " << frame;
  }
}

/// The source's numbers are the clock: frames that the take lacks are held, so that editors find it as long
/// as it was.
TEST_F(TakeWithSound, AFilmHoldsWhatIsMissing) {
  take::TakeRecorderConfig config;
  config.file = file("gap.take");
  config.when_full = take::WhenFull::Wait;
  config.disk_reserve_bytes = 0;
  take::TakeRecorder recorder(config);
  recorder.start();
  const auto subject = test::patch_subject();
  for (const int i : {0, 1, 2, 3, 4, 9, 10}) {
    auto frame = test::patch_frame(static_cast<std::uint64_t>(i), subject, nullptr);
    frame.timestamp_ns = time_of(i);
    frame.media_time_ns = i * 40'000'000LL;
    recorder.record(std::make_shared<mesh::MeshFrame>(frame));
  }
  ASSERT_EQ(recorder.stop().frames, 7U);
  ASSERT_EQ(run({"export", file("gap.take"), "--format", "mp4", "--size", "64", "-o", file("gap.mp4")}), 0)
      << output_;
  EXPECT_THAT(output_, AllOf(HasSubstr("0.44 s at 25 Hz"), HasSubstr("the take has no sound")));
  const std::string pictures =
      decoded(file("gap.mp4"), {"-vf", "scale=1:1:flags=area,format=gray", "-f", "rawvideo"}, file("p"));
  EXPECT_EQ(pictures.size(), 11U);
  EXPECT_EQ(run({"export", file("gap.take"), "--format", "mp4", "-o", file("gap.avi")}), 2);
  EXPECT_EQ(run({"export", file("gap.take"), "--format", "mp4", "--panels", "hat", "-o", file("b.mp4")}), 2);
  EXPECT_THAT(output_, HasSubstr("no panel 'hat'; it can have, with commas between: picture, mesh, grey"));
  EXPECT_EQ(run({"export", file("gap.take"), "--format", "ply", "--panels", "grey", "-o", file("b")}), 2);
  EXPECT_THAT(output_, HasSubstr("--panels and --video are for mp4, not for ply"));
  EXPECT_EQ(run({"export", file("gap.take"), "--format", "mp4", "--size", "16384", "-o", file("b.mp4")}), 2);
  EXPECT_THAT(output_, HasSubstr("can't make a video of 26216x16412 px"));
  test::write_grey_video(file("small.mkv"), 12);
  EXPECT_EQ(run({"export", file("gap.take"), "--format", "mp4", "--panels", "mesh", "--video",
                 file("small.mkv"), "-o", file("b.mp4")}),
            2);
  EXPECT_THAT(output_, HasSubstr("the pictures are of 320x240 px, the take was made from such of"));
  EXPECT_FALSE(std::filesystem::exists(file("b.mp4")));
}

TEST_F(TakeWithSound, WithoutItsFileSaysSo) {
  std::filesystem::remove(file("a.flac"));
  EXPECT_EQ(run({"export", file("a.take"), "--format", "wav", "-o", file("b.wav")}), 3);
  EXPECT_THAT(output_, HasSubstr("a.flac': there is no such file"));
  EXPECT_FALSE(std::filesystem::exists(file("b.wav")));
  ASSERT_EQ(run({"export", file("a.take"), "--format", "mp4", "--size", "64", "-o", file("b.mp4")}), 0)
      << output_ << ": a film is one without sound, too";
  EXPECT_THAT(output_, AllOf(HasSubstr("note: the film has no sound: "), HasSubstr("there is no such file")));
}

}  // namespace
}  // namespace facet::sound
