// PNG and JPEG against ffmpeg, which has readers and writers of its own; what is cut short, damaged or too
// large.

#include "files/image_file.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <random>

#include "facet/error.hpp"
#include "support/jpeg_picture.hpp"
#include "support/paths.hpp"
#include "support/png_head.hpp"

namespace facet::files {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::vector<std::uint8_t> bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

template <typename Value>
std::vector<Value> noise(std::size_t count) {
  std::mt19937 random(7);
  std::vector<Value> values(count);
  for (Value& value : values) {
    value = static_cast<Value>(random());
  }
  return values;
}

RgbImage<std::uint8_t> parse(const std::vector<std::uint8_t>& bytes,
                             std::size_t most_pixels = kMostImagePixels) {
  return parse_image<std::uint8_t>(std::as_bytes(std::span(bytes)), "it", most_pixels);
}

std::string refusal_of(const std::vector<std::uint8_t>& bytes, std::size_t most_pixels = kMostImagePixels) {
  try {
    parse(bytes, most_pixels);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return "";
}

/// A picture of gentle slopes, which JPEG keeps within a few steps.
std::vector<std::uint8_t> slopes(int width_px, int height_px, int channels) {
  std::vector<std::uint8_t> values;
  for (int y = 0; y < height_px; ++y) {
    for (int x = 0; x < width_px; ++x) {
      for (int channel = 0; channel < channels; ++channel) {
        values.push_back(static_cast<std::uint8_t>(40 + 150 * x / width_px + 60 * y / height_px));
      }
    }
  }
  return values;
}

class Peers : public ::testing::Test {
 protected:
  void SetUp() override {
    if (std::system("command -v ffmpeg >/dev/null 2>&1") != 0) {
      GTEST_SKIP() << "the ffmpeg program is not installed";
    }
  }
  std::filesystem::path file(const std::string& name) const { return folder_.path() / name; }
  void ffmpeg(const std::string& arguments) const {
    const std::string command =
        fmt::format("cd '{}' && ffmpeg -nostdin -v error -y {}", folder_.path().string(), arguments);
    ASSERT_EQ(std::system(command.c_str()), 0) << command;
  }
  template <typename Value>
  std::vector<Value> raw(const std::string& name) const {
    const std::vector<std::uint8_t> bytes = bytes_of(file(name));
    std::vector<Value> values(bytes.size() / sizeof(Value));
    std::memcpy(values.data(), bytes.data(), values.size() * sizeof(Value));
    return values;
  }

 private:
  test::TemporaryFolder folder_;
};

TEST_F(Peers, PngsOfEightBitsAndLessAreReadAsTheyAre) {
  for (const char* kind : {"gray", "ya8", "rgb24", "rgba", "pal8", "monob"}) {
    for (const char* way : {"", "-flags +ildct"}) {  // the other is interlaced (Adam7)
      ffmpeg(fmt::format("-f lavfi -i testsrc=s=61x35 -frames:v 1 -pix_fmt {} {} it.png", kind, way));
      ffmpeg("-i it.png -f rawvideo -pix_fmt rgb24 it.raw");
      const auto image = read_image<std::uint8_t>(file("it.png"));
      EXPECT_EQ(image.width_px, 61);
      EXPECT_EQ(image.height_px, 35);
      EXPECT_EQ(image.values, raw<std::uint8_t>("it.raw")) << kind << way;
      const auto wide = read_image<std::uint16_t>(file("it.png"));
      ASSERT_EQ(wide.values.size(), image.values.size());
      for (std::size_t i = 0; i < wide.values.size(); ++i) {
        ASSERT_EQ(wide.values[i], 257 * image.values[i]) << kind;
      }
    }
  }
}

TEST_F(Peers, PngsOfSixteenBitsAreReadAsTheyAre) {
  for (const char* kind : {"gray16be", "ya16be", "rgb48be", "rgba64be"}) {
    ffmpeg(fmt::format("-f lavfi -i testsrc=s=61x35 -frames:v 1 -pix_fmt {} it.png", kind));
    ffmpeg("-i it.png -f rawvideo -pix_fmt rgb48le it.raw");
    EXPECT_EQ(read_image<std::uint16_t>(file("it.png")).values, raw<std::uint16_t>("it.raw")) << kind;
    const auto narrow = read_image<std::uint8_t>(file("it.png"));
    const auto wide = raw<std::uint16_t>("it.raw");
    for (std::size_t i = 0; i < wide.size(); ++i) {
      ASSERT_EQ(narrow.values[i], std::lround(wide[i] / 257.0)) << kind;
    }
  }
}

TEST_F(Peers, WrittenPngsAreReadAsTheyWere) {
  const auto write = [&](const std::vector<std::uint8_t>& bytes) {
    std::ofstream(file("it.png"), std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  };
  for (const bool colour : {false, true}) {
    const std::size_t count = std::size_t{61} * 35 * (colour ? 3 : 1);
    const auto narrow = noise<std::uint8_t>(count);
    write(encode_png(61, 35, narrow));
    EXPECT_EQ(test::png_head_of(file("it.png")), (test::PngHead{61, 35, 8, colour}));
    ffmpeg(fmt::format("-i it.png -f rawvideo -pix_fmt {} it.raw", colour ? "rgb24" : "gray"));
    EXPECT_EQ(raw<std::uint8_t>("it.raw"), narrow);
    const auto wide = noise<std::uint16_t>(count);
    write(encode_png(61, 35, wide));
    EXPECT_EQ(test::png_head_of(file("it.png")), (test::PngHead{61, 35, 16, colour}));
    ffmpeg(fmt::format("-i it.png -f rawvideo -pix_fmt {} it.raw", colour ? "rgb48le" : "gray16le"));
    EXPECT_EQ(raw<std::uint16_t>("it.raw"), wide);
  }
}

TEST_F(Peers, WrittenJpegsAreReadByOthers) {
  for (const bool colour : {false, true}) {
    const std::size_t channels = colour ? 3 : 1;
    std::vector<std::uint8_t> values(std::size_t{61} * 35 * channels);
    for (std::size_t i = 0; i < values.size(); ++i) {
      values[i] = static_cast<std::uint8_t>(60 + i / channels % 61 + 30 * (i % channels));
    }
    const std::vector<std::uint8_t> jpeg = encode_jpeg(61, 35, values, 92);
    std::ofstream(file("it.jpg"), std::ios::binary)
        .write(reinterpret_cast<const char*>(jpeg.data()), static_cast<std::streamsize>(jpeg.size()));
    ffmpeg(fmt::format("-i it.jpg -f rawvideo -pix_fmt {} it.raw", colour ? "rgb24" : "gray"));
    const auto got = raw<std::uint8_t>("it.raw");
    ASSERT_EQ(got.size(), values.size());
    int worst = 0;
    for (std::size_t i = 0; i < values.size(); ++i) {
      worst = std::max(worst, std::abs(got[i] - values[i]));
    }
    EXPECT_LE(worst, 8) << (colour ? "colour" : "grey");
  }
  EXPECT_THROW(encode_jpeg(61, 35, std::vector<std::uint8_t>(12), 92), Error);
}

TEST_F(Peers, JpegsAreReadAsOthersReadThem) {
  for (const char* kind : {"yuvj420p", "yuvj422p", "yuvj444p", "gray"}) {
    ffmpeg(
        fmt::format("-f lavfi -i 'gradients=s=61x35:c0=red:c1=blue:seed=3' -frames:v 1 -q:v 2 "
                    "-pix_fmt {} it.jpg",
                    kind));
    ffmpeg("-i it.jpg -f rawvideo -pix_fmt rgb24 it.raw");
    const auto image = read_image<std::uint8_t>(file("it.jpg"));
    const auto truth = raw<std::uint8_t>("it.raw");
    ASSERT_EQ(image.values.size(), truth.size());
    double sum = 0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      sum += std::abs(image.values[i] - truth[i]);
    }
    EXPECT_LT(sum / static_cast<double>(truth.size()), 2) << kind;
  }
}

TEST(Image, JpegsOfSeveralScansAndOfGreyAreRead) {
  const std::vector<std::uint8_t> grey = slopes(40, 24, 1);
  const auto read = parse(test::jpeg_from(grey, 40, 24));
  for (std::size_t i = 0; i < grey.size(); ++i) {
    for (std::size_t channel = 0; channel < 3; ++channel) {
      ASSERT_NEAR(read.values[3 * i + channel], grey[i], 2);
    }
  }
  const auto scans = parse(test::jpeg_from(slopes(40, 24, 3), 40, 24, true));
  for (std::size_t i = 0; i < scans.values.size(); ++i) {
    ASSERT_NEAR(scans.values[i], grey[i / 3], 3);
  }
}

/// A camera that was turned says so in EXIF; 6: its right side is the picture's bottom.
TEST(Image, AJpegComesOutUpright) {
  const std::vector<std::uint8_t> stored = slopes(40, 24, 1);
  const std::vector<std::uint8_t> plain = test::jpeg_from(stored, 40, 24);
  for (int orientation = 1; orientation <= 8; ++orientation) {
    for (const bool big_endian : {false, true}) {
      const auto value = static_cast<std::uint8_t>(orientation);
      const std::vector<std::uint8_t> tiff =
          big_endian ? std::vector<std::uint8_t>{'M',  'M', 0, 42, 0, 0, 0, 8, 0,     1, 1,
                                                 0x12, 0,   3, 0,  0, 0, 1, 0, value, 0, 0}
                     : std::vector<std::uint8_t>{'I', 'I', 42, 0, 8, 0, 0, 0,     1, 0, 0x12,
                                                 1,   3,   0,  1, 0, 0, 0, value, 0, 0, 0};
      std::vector<std::uint8_t> turned = {
          0xFF, 0xD8, 0xFF, 0xE1, 0, static_cast<std::uint8_t>(8 + tiff.size()), 'E', 'x', 'i', 'f', 0, 0};
      std::copy(tiff.begin(), tiff.end(), std::back_inserter(turned));
      std::copy(plain.begin() + 2, plain.end(), std::back_inserter(turned));
      const auto image = parse(turned);
      ASSERT_EQ(image.width_px, orientation < 5 ? 40 : 24) << orientation;
      ASSERT_EQ(image.height_px, orientation < 5 ? 24 : 40) << orientation;
      // Where the stored picture's first row and first column are to be seen, as the standard's table says.
      const auto corner = [&](bool right, bool bottom) {
        const int x = right ? image.width_px - 1 : 0;
        const int y = bottom ? image.height_px - 1 : 0;
        return image.values[3 * static_cast<std::size_t>(y * image.width_px + x)];
      };
      constexpr std::array kFirstRight = {false, true, true, false, false, true, true, false};
      constexpr std::array kFirstBottom = {false, false, true, true, false, false, true, true};
      const auto at = static_cast<std::size_t>(orientation - 1);
      EXPECT_NEAR(corner(kFirstRight[at], kFirstBottom[at]), 40, 4) << orientation;
      EXPECT_NEAR(corner(!kFirstRight[at], !kFirstBottom[at]), 243, 6) << orientation;
      // 40 px wide, it grows by 150 along its stored rows and by 60 along its columns.
      const double along_x = std::abs(corner(true, false) - corner(false, false));
      EXPECT_NEAR(along_x, orientation < 5 ? 146 : 57, 8) << orientation;
    }
  }
}

TEST(Image, WhatIsCutShortOrDamagedIsRefused) {
  const std::vector<std::uint8_t> png = encode_png(13, 7, noise<std::uint8_t>(std::size_t{3} * 13 * 7));
  const std::vector<std::uint8_t> jpeg = test::jpeg_from(slopes(40, 24, 3), 40, 24);
  for (const auto& whole : {png, jpeg}) {
    for (std::size_t size = 0; size + 2 < whole.size(); ++size) {
      ASSERT_NE(refusal_of({whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size)}), "")
          << size << " of " << whole.size();
    }
  }
  // Every chunk of a PNG has a sum.
  for (std::size_t at = 8; at < png.size(); ++at) {
    std::vector<std::uint8_t> damaged = png;
    damaged[at] ^= 0x10;
    ASSERT_NE(refusal_of(damaged), "") << at;
  }
  std::mt19937 random(5);
  for (int k = 0; k < 2000; ++k) {
    std::vector<std::uint8_t> damaged = jpeg;
    for (int byte = 0; byte < 3; ++byte) {
      damaged[random() % damaged.size()] = static_cast<std::uint8_t>(random());
    }
    refusal_of(damaged, 1'000'000);  // read or refused
  }
}

TEST(Image, SaysWhatIsWrong) {
  EXPECT_THAT(refusal_of({}), AllOf(HasSubstr("it: "), HasSubstr("empty")));
  EXPECT_THAT(refusal_of({'B', 'M', 1, 2}), HasSubstr("neither PNG nor JPEG"));
  EXPECT_THAT(refusal_of(test::jpeg_from(slopes(16, 16, 4), 16, 16)), HasSubstr("CMYK"));
  const test::TemporaryFolder folder;
  try {
    read_image<std::uint8_t>(folder.path() / "absent.png");
    FAIL() << "read a file that is not there";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    EXPECT_THAT(error.what(), HasSubstr("absent.png"));
  }
}

/// The size is known before memory is taken: a few bytes may promise gigabytes.
TEST(Image, TooLargeIsRefusedByItsHead) {
  EXPECT_THAT(refusal_of(encode_png(40, 24, noise<std::uint8_t>(960)), 959), HasSubstr("40x24 px"));
  EXPECT_THAT(refusal_of(test::jpeg_from(slopes(40, 24, 3), 40, 24), 959), HasSubstr("40x24 px"));
  EXPECT_EQ(refusal_of(encode_png(40, 24, noise<std::uint8_t>(960)), 960), "");
  EXPECT_THAT(refusal_of(encode_png(40000, 1, noise<std::uint8_t>(40000))), HasSubstr("40000x1 px"));
  EXPECT_THROW(encode_png(3, 3, noise<std::uint8_t>(10)), Error);
  EXPECT_THROW(encode_png(0, 3, std::vector<std::uint16_t>{}), Error);
}

}  // namespace
}  // namespace facet::files
