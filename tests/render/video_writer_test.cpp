#include "render/video_writer.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "facet/error.hpp"
#include "simulation/random.hpp"
#include "support/paths.hpp"

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
}

namespace facet::render {
namespace {

Picture noise(int width_px, int height_px, std::uint64_t seed) {
  simulation::Random random(seed, 0);
  Picture picture = plain_picture(width_px, height_px, {0, 0, 0});
  for (auto& value : picture.rgb) {
    value = static_cast<std::uint8_t>(random.below(256));
  }
  return picture;
}

TEST(VideoWriter, DecodesToExactlyWhatWentIn) {
  for (const auto& [width, height] : {std::pair{64, 48}, {127, 13}}) {
    const test::TemporaryFolder folder;
    const auto file = folder.path() / "video.mkv";
    {
      VideoWriter video(file, width, height, 30);
      for (std::uint64_t k = 0; k < 5; ++k) {
        video.append(noise(width, height, k));
      }
      video.finish();
    }
    const auto camera = camera::open_camera({.kind = "file", .path = file});
    EXPECT_EQ(camera->info().width_px, width);
    EXPECT_NEAR(camera->info().rate_hz, 30, 0.01);
    camera->start();
    Frame frame;
    for (std::uint64_t k = 0; k < 5; ++k) {
      ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered)
          << camera->last_error();
      EXPECT_EQ(to_picture(frame).rgb, noise(width, height, k).rgb) << k;
    }
    EXPECT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::EndOfStream);
  }
}

/// Smooth shapes that move, coloured, and a sensor's noise.
Picture scene(int width_px, int height_px, int frame) {
  simulation::Random random(static_cast<std::uint64_t>(frame), 1);
  Picture picture = plain_picture(width_px, height_px, {0, 0, 0});
  std::size_t at = 0;
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) {
      const float wave = std::sin(0.11F * static_cast<float>(x + 3 * frame) + 0.07F * static_cast<float>(y));
      for (const float tint : {0.9F, 0.6F, 0.4F}) {
        const float value = 128 + 90 * tint * wave + 2 * random.normal();
        picture.rgb[at++] = static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.0F, 255.0F)));
      }
    }
  }
  return picture;
}

struct Stream {
  AVCodecID codec = AV_CODEC_ID_NONE;
  bool chroma_is_halved = false;
  double bits_per_second = 0;
};

/// What FFmpeg says of a file.
Stream stream_of(const std::filesystem::path& file, double duration_s) {
  Stream stream;
  AVFormatContext* format = nullptr;
  EXPECT_EQ(avformat_open_input(&format, file.c_str(), nullptr, nullptr), 0);
  EXPECT_GE(avformat_find_stream_info(format, nullptr), 0);
  const AVCodecParameters& found = *format->streams[0]->codecpar;
  stream.codec = found.codec_id;
  stream.chroma_is_halved = found.format == AV_PIX_FMT_YUV420P || found.format == AV_PIX_FMT_YUVJ420P;
  stream.bits_per_second = 8 * static_cast<double>(std::filesystem::file_size(file)) / duration_s;
  avformat_close_input(&format);
  return stream;
}

std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

TEST(VideoWriter, WebcamsCodecsKeepTheirRateAndColours) {
  constexpr int kFrames = 60;
  const test::TemporaryFolder folder;
  for (const VideoCodec codec : {VideoCodec::H264, VideoCodec::MotionJpeg}) {
    for (const char* name : {"a.mkv", "b.mkv"}) {
      VideoWriter video(folder.path() / name, 320, 180, 30, codec);
      for (int k = 0; k < kFrames; ++k) {
        video.append(scene(320, 180, k));
      }
      video.finish();
    }
    EXPECT_EQ(bytes_of(folder.path() / "a.mkv"), bytes_of(folder.path() / "b.mkv"));
    const Stream stream = stream_of(folder.path() / "a.mkv", kFrames / 30.0);
    EXPECT_EQ(stream.codec, codec == VideoCodec::H264 ? AV_CODEC_ID_H264 : AV_CODEC_ID_MJPEG);
    EXPECT_TRUE(stream.chroma_is_halved);
    if (codec == VideoCodec::H264) {
      const auto wanted = static_cast<double>(webcam_bits_per_second(320, 180, 30));
      EXPECT_GT(stream.bits_per_second, 0.5 * wanted);
      EXPECT_LT(stream.bits_per_second, 1.5 * wanted);
    } else {
      EXPECT_GT(stream.bits_per_second, 0.02 * 24 * 320 * 180 * 30);
      EXPECT_LT(stream.bits_per_second, 0.2 * 24 * 320 * 180 * 30);
    }
    // Colours and brightness come back: the coding's matrix and range are what the file says.
    const auto camera = camera::open_camera({.kind = "file", .path = folder.path() / "a.mkv"});
    camera->start();
    Frame frame;
    for (int k = 0; k < kFrames; ++k) {
      ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered);
    }
    const Picture seen = to_picture(frame);
    const Picture sent = scene(320, 180, kFrames - 1);
    double squares = 0;
    double bias[3] = {};
    for (std::size_t k = 0; k < seen.rgb.size(); ++k) {
      const double difference = static_cast<double>(seen.rgb[k]) - sent.rgb[k];
      squares += difference * difference;
      bias[k % 3] += difference;
    }
    const auto count = static_cast<double>(seen.rgb.size());
    EXPECT_LT(std::sqrt(squares / count), 8);
    EXPECT_GT(std::sqrt(squares / count), 0.5);  // lossy
    for (const double sum : bias) {
      EXPECT_NEAR(3 * sum / count, 0, 1);
    }
  }
}

TEST(VideoWriter, H264GetsWhatWebcamsSend) {
  EXPECT_EQ(webcam_bits_per_second(1280, 720, 30), 3'000'000);
  EXPECT_NEAR(static_cast<double>(webcam_bits_per_second(640, 360, 30)), 3e6 / std::pow(4, 0.75), 1);
  EXPECT_EQ(webcam_bits_per_second(1280, 720, 60), 6'000'000);
}

TEST(VideoWriter, FilmsAreShownAtTheTimesThatWereGiven) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "a.mp4";
  const std::vector<double> times_s = {0, 0.04, 0.1, 0.5, 0.5333};
  {
    VideoWriter film(file, VideoFormat{.width_px = 320,
                                       .height_px = 180,
                                       .rate_hz = 29.97,
                                       .codec = VideoCodec::Film,
                                       .timecode = "01:00:01:00"});
    for (std::size_t k = 0; k < times_s.size(); ++k) {
      film.append(scene(320, 180, static_cast<int>(k)), times_s[k]);
    }
    EXPECT_THROW(film.append(scene(320, 180, 0), 0.5), Error) << "time does not rise";
    EXPECT_FALSE(std::filesystem::exists(file)) << "not before it is whole";
    film.finish();
  }
  AVFormatContext* format = nullptr;
  ASSERT_EQ(avformat_open_input(&format, file.c_str(), nullptr, nullptr), 0);
  ASSERT_GE(avformat_find_stream_info(format, nullptr), 0);
  EXPECT_EQ(format->streams[0]->codecpar->codec_id, AV_CODEC_ID_H264);
  const AVDictionaryEntry* timecode = av_dict_get(format->streams[0]->metadata, "timecode", nullptr, 0);
  ASSERT_NE(timecode, nullptr);
  EXPECT_STREQ(timecode->value, "01:00:01:00");
  std::vector<double> seen_s;
  AVPacket* packet = av_packet_alloc();
  while (av_read_frame(format, packet) >= 0) {
    if (packet->stream_index == 0) {
      seen_s.push_back(static_cast<double>(packet->pts) * av_q2d(format->streams[0]->time_base));
    }
    av_packet_unref(packet);
  }
  av_packet_free(&packet);
  avformat_close_input(&format);
  std::sort(seen_s.begin(), seen_s.end());  // B-frames come behind
  ASSERT_EQ(seen_s.size(), times_s.size());
  for (std::size_t k = 0; k < times_s.size(); ++k) {
    EXPECT_NEAR(seen_s[k], times_s[k], 2e-5) << k;
  }
}

TEST(VideoWriter, AFilmThatIsNotFinishedLeavesNothing) {
  const test::TemporaryFolder folder;
  for (const char* name : {"a.mp4", "a.mkv"}) {
    VideoWriter video(folder.path() / name,
                      {.width_px = 64,
                       .height_px = 64,
                       .codec = std::string(name) == "a.mp4" ? VideoCodec::Film : VideoCodec::Lossless});
    video.append(noise(64, 64, 1));
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

TEST(VideoWriter, RefusesWhatItCannotDo) {
  const test::TemporaryFolder folder;
  EXPECT_THROW(VideoWriter(folder.path() / "a.mkv", 15, 16, 30, VideoCodec::H264), Error);
  EXPECT_THROW(VideoWriter(folder.path() / "a.mkv", 16, 15, 30, VideoCodec::MotionJpeg), Error);
  EXPECT_THROW(VideoWriter(folder.path() / "a.mkv", 0, 10, 30), Error);
  EXPECT_THROW(VideoWriter(folder.path() / "missing" / "a.mkv", 16, 16, 30), Error);
  const auto film = [&](double rate_hz, FilmSound sound) {
    return VideoWriter(
        folder.path() / "a.mp4",
        {.width_px = 64, .height_px = 64, .rate_hz = rate_hz, .codec = VideoCodec::Film, .sound = sound});
  };
  EXPECT_THROW(film(0, {}), Error);
  EXPECT_THROW(film(25, {12345, 1}), Error);
  EXPECT_THROW(film(25, {48000, 9}), Error);
  EXPECT_THROW(film(25, {48000, 0}), Error);
  VideoWriter video(folder.path() / "b.mkv", 16, 16, 30);
  EXPECT_THROW(video.append(noise(17, 16, 1)), Error);
  video.append(noise(16, 16, 1));
  video.finish();
  EXPECT_NO_THROW(video.finish());
  EXPECT_THROW(video.append(noise(16, 16, 1)), Error);
}

}  // namespace
}  // namespace facet::render
