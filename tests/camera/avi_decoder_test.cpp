// Motion JPEG in AVI, read by ourselves: files of ffmpeg, and files that are cut short, damaged or something
// else.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <random>

#include "camera/avi_index.hpp"
#include "camera/factory.hpp"
#include "camera/video_decoder.hpp"
#include "facet/error.hpp"
#include "support/avi_file.hpp"
#include "support/jpeg_picture.hpp"
#include "support/paths.hpp"

namespace facet::camera {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

constexpr int kWidth_px = 36;
constexpr int kHeight_px = 20;

/// Pictures of one colour each, brighter from one to the next.
std::uint8_t level(std::size_t k) {
  return static_cast<std::uint8_t>(20 + 20 * k);
}

test::AviFile clip(std::size_t count) {
  test::AviFile avi{.width_px = kWidth_px, .height_px = kHeight_px};
  for (std::size_t k = 0; k < count; ++k) {
    avi.pictures.push_back(test::jpeg_of({level(k), level(k), level(k)}, kWidth_px, kHeight_px));
  }
  avi.named_pictures = static_cast<std::uint32_t>(count);
  return avi;
}

class AviDecoderTest : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& bytes) const {
    const std::filesystem::path file = folder_.path() / "it.avi";
    std::ofstream(file, std::ios::binary) << bytes;
    return file;
  }

  struct Seen {
    std::vector<int> levels{};
    std::vector<std::int64_t> times_ns{};
    std::vector<bool> damaged{};
  };
  static Seen all_of(VideoDecoder& decoder) {
    Seen seen;
    while (decoder.advance()) {
      seen.times_ns.push_back(decoder.time_ns().value_or(-1));
      seen.damaged.push_back(decoder.damaged());
      const auto picture = decoder.take_picture();
      seen.levels.push_back(picture[0]);
      for (const int channel : {1, 2}) {
        EXPECT_NEAR(picture[channel], picture[0], 2);
      }
      EXPECT_EQ(picture[3], 255);
    }
    return seen;
  }
  static void expect_levels(const Seen& seen, const std::vector<std::size_t>& pictures) {
    ASSERT_EQ(seen.levels.size(), pictures.size());
    for (std::size_t i = 0; i < pictures.size(); ++i) {
      EXPECT_NEAR(seen.levels[i], level(pictures[i]), 2) << i;
    }
  }

  test::TemporaryFolder folder_;
};

TEST_F(AviDecoderTest, GivesEveryPictureWithItsTime) {
  test::AviFile avi = clip(5);
  avi.rate = 30000;
  avi.scale = 1001;
  for (const bool with_sound : {false, true}) {
    for (const std::size_t second_part : {SIZE_MAX, std::size_t{3}}) {
      avi.with_sound = with_sound;
      avi.second_part = second_part;
      const auto decoder = open_avi_decoder(write(avi.bytes()));
      ASSERT_NE(decoder, nullptr);
      EXPECT_EQ(decoder->facts().width_px, kWidth_px);
      EXPECT_EQ(decoder->facts().height_px, kHeight_px);
      EXPECT_NEAR(decoder->facts().rate_hz, 29.97, 1e-3);
      EXPECT_EQ(decoder->facts().frame_count, 5U);
      for (int pass = 0; pass < 2; ++pass) {
        const Seen seen = all_of(*decoder);
        expect_levels(seen, {0, 1, 2, 3, 4});
        for (std::size_t k = 0; k < 5; ++k) {
          EXPECT_NEAR(static_cast<double>(seen.times_ns[k]), 1001e9 / 30000 * static_cast<double>(k), 1);
        }
        EXPECT_TRUE(decoder->rewind());
      }
      EXPECT_EQ(decoder->trouble(), "");
    }
  }
}

/// A recorder that could not keep up leaves empty pieces: no picture, but time goes on.
TEST_F(AviDecoderTest, DroppedPicturesLeaveAGapInTime) {
  test::AviFile avi = clip(4);
  avi.rate = 10;
  avi.pictures[1].clear();
  const auto decoder = open_avi_decoder(write(avi.bytes()));
  ASSERT_NE(decoder, nullptr);
  const Seen seen = all_of(*decoder);
  expect_levels(seen, {0, 2, 3});
  EXPECT_THAT(seen.times_ns, testing::ElementsAre(0, 200'000'000, 300'000'000));
}

TEST_F(AviDecoderTest, ADamagedPictureCostsItselfOnly) {
  test::AviFile avi = clip(4);
  avi.pictures[1].resize(avi.pictures[1].size() - 10);
  avi.pictures[2].assign(100, 0x55);
  const auto decoder = open_avi_decoder(write(avi.bytes()));
  ASSERT_NE(decoder, nullptr);
  const Seen seen = all_of(*decoder);
  ASSERT_EQ(seen.levels.size(), 3U);
  EXPECT_THAT(seen.damaged, testing::ElementsAre(false, true, false));
  EXPECT_NEAR(seen.levels[2], level(3), 2);
  EXPECT_THAT(decoder->trouble(), HasSubstr("near frame 2 was skipped (no JPEG picture of 36x20 px)"));
}

/// Wherever it is cut: what is there comes out, and what is missing is told.
TEST_F(AviDecoderTest, ATruncatedFileGivesWhatItHoldsAndSaysSo) {
  const test::AviFile avi = clip(6);
  const std::string whole = avi.bytes();
  const std::size_t begin = whole.find("00dc");
  std::size_t most = 0;
  for (std::size_t size = begin + 8 + avi.pictures.front().size(); size < whole.size(); size += 97) {
    const auto camera = open_camera({.kind = "file", .path = write(whole.substr(0, size))});
    camera->start();
    std::size_t count = 0;
    for (Frame frame; camera->next(frame, 5s) == CaptureOutcome::Delivered;) {
      EXPECT_NEAR(frame.row(0)[0], level(count), 2);
      ++count;
    }
    EXPECT_GE(count, most) << size;
    most = count;
    if (count < 5) {
      EXPECT_THAT(camera->last_error(), testing::AnyOf(HasSubstr("it.avi: ended at frame"),
                                                       HasSubstr("was skipped (no JPEG picture")))
          << size;
    }
  }
  EXPECT_EQ(most, 5U);
  for (std::size_t size = 0; size < begin; size += 3) {
    const auto decoder = open_avi_decoder(write(whole.substr(0, size)));
    EXPECT_EQ(decoder, nullptr) << size;
  }
}

TEST_F(AviDecoderTest, AnyBytesAreReadOrNot) {
  const std::string whole = clip(3).bytes();
  std::mt19937 random(9);
  for (int k = 0; k < 500; ++k) {
    std::string damaged = whole;
    for (int byte = 0; byte < 4; ++byte) {
      // Most of it is JPEG, which has tests of its own: the heads are damaged as often.
      const std::size_t span = byte % 2 == 0 ? 400 : damaged.size();
      damaged[random() % span] = static_cast<char>(random());
    }
    const auto decoder = open_avi_decoder(write(damaged));
    if (decoder != nullptr) {
      std::size_t count = 0;
      while (decoder->advance()) {
        ++count;
      }
      EXPECT_LE(count, 3U);
    }
  }
}

TEST_F(AviDecoderTest, WhatOnlyFfmpegKnowsIsLeftToIt) {
  EXPECT_EQ(open_avi_decoder(write("not an AVI file, but long enough")), nullptr);
  test::AviFile other = clip(2);
  other.coding = "H264";
  EXPECT_EQ(open_avi_decoder(write(other.bytes())), nullptr);
  test::AviFile fields = clip(2);
  fields.height_px = 2 * kHeight_px;  // each piece holds half the lines
  EXPECT_EQ(open_avi_decoder(write(fields.bytes())), nullptr);
  test::AviFile wide = clip(2);
  wide.aspect = 4U << 16U | 1U;
  EXPECT_EQ(open_avi_decoder(write(wide.bytes())), nullptr);
  wide.aspect = 9U << 16U | 5U;  // 36:20
  EXPECT_NE(open_avi_decoder(write(wide.bytes())), nullptr);
  test::AviFile oblong = clip(2);
  oblong.pictures[0][15] = 2;  // JFIF: a pixel twice as wide
  EXPECT_EQ(open_avi_decoder(write(oblong.bytes())), nullptr);
  EXPECT_EQ(open_avi_decoder("/dev/null"), nullptr);
}

TEST_F(AviDecoderTest, AFileWithoutARateHasTheOneThatItsHeadNames) {
  test::AviFile avi = clip(2);
  avi.rate = 0;
  const auto decoder = open_avi_decoder(write(avi.bytes()));
  ASSERT_NE(decoder, nullptr);
  EXPECT_NEAR(decoder->facts().rate_hz, 30, 0.001);  // 33,333 us
}

/// The same pictures in Matroska are read by FFmpeg.
TEST_F(AviDecoderTest, ComesOutAsFfmpegReadsIt) {
  if (std::system("command -v ffmpeg >/dev/null 2>&1") != 0) {
    GTEST_SKIP() << "the ffmpeg program is not installed";
  }
  const std::string avi = (folder_.path() / "it.avi").string();
  const std::string mkv = (folder_.path() / "it.mkv").string();
  ASSERT_EQ(
      std::system(fmt::format("ffmpeg -nostdin -v error -y -f lavfi -i testsrc=s=161x121:r=20 -f lavfi -i "
                              "sine -frames:v 12 -shortest -c:v mjpeg -pix_fmt yuvj444p -q:v 3 -c:a "
                              "pcm_s16le '{0}' && ffmpeg -nostdin -v error -y -i '{0}' -c copy '{1}'",
                              avi, mkv)
                      .c_str()),
      0);
  const auto ours = open_avi_decoder(avi);
  ASSERT_NE(ours, nullptr);
  EXPECT_EQ(open_avi_decoder(mkv), nullptr);
  const auto theirs = open_ffmpeg_decoder(mkv);
  EXPECT_EQ(ours->facts().width_px, theirs->facts().width_px);
  EXPECT_EQ(ours->facts().height_px, theirs->facts().height_px);
  EXPECT_NEAR(ours->facts().rate_hz, 20, 1e-9);
  int count = 0;
  while (ours->advance()) {
    ASSERT_TRUE(theirs->advance());
    EXPECT_NEAR(static_cast<double>(*ours->time_ns()), 50e6 * count, 1);
    EXPECT_NEAR(static_cast<double>(*theirs->time_ns()), 50e6 * count, 1e6);  // Matroska keeps milliseconds
    const auto a = ours->take_picture();
    const auto b = theirs->take_picture();
    double sum = 0;
    for (int y = 0; y < 121; ++y) {
      const std::ptrdiff_t row = std::ptrdiff_t{y} * rgba_stride_bytes(161);
      for (std::ptrdiff_t i = 0; i < 4 * 161; ++i) {
        sum += std::abs(a[row + i] - b[row + i]);
      }
    }
    EXPECT_LT(sum / (4 * 161 * 121), 1.5) << count;
    ++count;
  }
  EXPECT_FALSE(theirs->advance());
  EXPECT_EQ(count, 12);
}

}  // namespace
}  // namespace facet::camera
