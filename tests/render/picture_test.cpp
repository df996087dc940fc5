#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <random>

#include "facet/error.hpp"
#include "maths/harmonics.hpp"
#include "render/renderer.hpp"
#include "support/paths.hpp"

namespace facet::render {
namespace {

Picture noise(int width_px, int height_px) {
  std::mt19937 random(11);
  Picture picture = plain_picture(width_px, height_px, {0, 0, 0});
  for (auto& value : picture.rgb) {
    value = static_cast<std::uint8_t>(random());
  }
  return picture;
}

TEST(Colour, SrgbRoundTripsEveryValue) {
  for (int value = 0; value < 256; ++value) {
    EXPECT_EQ(linear_to_srgb8(srgb8_to_linear(static_cast<std::uint8_t>(value))), value);
  }
  EXPECT_EQ(linear_to_srgb8(-1), 0);
  EXPECT_EQ(linear_to_srgb8(7), 255);
  EXPECT_NEAR(srgb8_to_linear(188), 0.5F, 0.005F);  // the well-known middle of sRGB
}

TEST(Colour, ShBasisIsEquationOne) {
  const Eigen::Vector3f n = Eigen::Vector3f(1, -2, 2) / 3;
  const auto basis = maths::harmonics(n.x(), n.y(), n.z());
  const std::array<float, 9> expected{1,        1.0F / 3,  -2.0F / 3, 2.0F / 3, -2.0F / 9,
                                      2.0F / 9, -4.0F / 9, -3.0F / 9, 1.0F / 3};
  for (std::size_t k = 0; k < 9; ++k) {
    EXPECT_NEAR(basis[k], expected[k], 1e-6F) << k;
  }
}

TEST(Colour, IrradianceTurnsTheCameraFrame) {
  EXPECT_FLOAT_EQ(irradiance({0, 0, 1, 0, 0, 0, 0, 0, 0}, {0, -1, 0}), 1);  // lit from above, facing up
  EXPECT_FLOAT_EQ(irradiance({0, 0, 0, 1, 0, 0, 0, 0, 0}, {0, 0, -1}), 1);  // lit from the camera, facing it
  EXPECT_FLOAT_EQ(irradiance({0, 1, 0, 0, 0, 0, 0, 0, 0}, {1, 0, 0}), 1);
}

TEST(Colour, HeatRunsFromDarkBlueToYellowAndGetsLighter) {
  const auto lightness = [](float value) {
    const auto rgb = heat_colour(value);
    return 0.2126F * srgb8_to_linear(rgb[0]) + 0.7152F * srgb8_to_linear(rgb[1]) +
           0.0722F * srgb8_to_linear(rgb[2]);
  };
  for (float value = 0; value < 0.985F; value += 0.02F) {
    EXPECT_GT(lightness(value + 0.02F), lightness(value)) << value;
  }
  EXPECT_EQ(heat_colour(-5), heat_colour(0));
  EXPECT_EQ(heat_colour(5), heat_colour(1));
  EXPECT_GT(heat_colour(0)[2], heat_colour(0)[0]);
  EXPECT_GT(heat_colour(1)[0], heat_colour(1)[2]);
  EXPECT_EQ(heat_colour(std::nanf("")), (std::array<std::uint8_t, 3>{128, 128, 128}));
}

TEST(Png, RoundTripsOddSizes) {
  const test::TemporaryFolder folder;
  for (const auto& [width, height] : {std::pair{1, 1}, {13, 127}, {64, 3}}) {
    const Picture picture = noise(width, height);
    write_png(picture, folder.path() / "picture.png");
    const Picture read = read_image(folder.path() / "picture.png");
    EXPECT_EQ(read.width_px, width);
    EXPECT_EQ(read.height_px, height);
    EXPECT_EQ(read.rgb, picture.rgb);
  }
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1);  // no half files
}

TEST(Png, SaysWhatIsWrong) {
  const test::TemporaryFolder folder;
  try {
    write_png(noise(3, 3), folder.path() / "missing" / "picture.png");
    FAIL() << "wrote into a folder that is not there";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Storage);
    EXPECT_NE(std::string(error.what()).find("picture.png"), std::string::npos);
  }
  std::ofstream(folder.path() / "text.png") << "not a picture";
  EXPECT_THROW(read_image(folder.path() / "text.png"), Error);
  EXPECT_THROW(read_image(folder.path() / "absent.png"), Error);
}

TEST(Picture, FrameRoundTripWithPaddedRows) {
  const Picture picture = noise(5, 3);
  const Frame packed = to_frame(picture);
  EXPECT_EQ(packed.row(2)[4 * 4 + 3], 255);
  EXPECT_EQ(to_picture(packed).rgb, picture.rgb);

  Frame padded = packed;
  padded.stride_bytes = 32;
  std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[3 * 32]());
  for (int y = 0; y < 3; ++y) {
    std::copy_n(packed.row(y), 20, pixels.get() + 32 * y);
  }
  padded.pixels = pixels;
  EXPECT_EQ(to_picture(padded).rgb, picture.rgb);
}

TEST(Picture, PasteAndCropCutAtTheEdges) {
  const Picture from = noise(4, 4);
  Picture onto = plain_picture(6, 5, {1, 2, 3});
  paste(onto, from, 4, -2);
  const auto at = [](const Picture& picture, int x, int y) {
    const auto* pixel = &picture.rgb[3 * static_cast<std::size_t>(y * picture.width_px + x)];
    return std::array<std::uint8_t, 3>{pixel[0], pixel[1], pixel[2]};
  };
  EXPECT_EQ(at(onto, 4, 0), at(from, 0, 2));
  EXPECT_EQ(at(onto, 5, 1), at(from, 1, 3));
  EXPECT_EQ(at(onto, 3, 0), (std::array<std::uint8_t, 3>{1, 2, 3}));
  EXPECT_EQ(at(onto, 4, 2), (std::array<std::uint8_t, 3>{1, 2, 3}));
  paste(onto, from, 100, 100);
  paste(onto, from, -100, 0);

  const Picture part = crop(from, -1, 2, 3, 4, {9, 9, 9});
  EXPECT_EQ(at(part, 0, 0), (std::array<std::uint8_t, 3>{9, 9, 9}));
  EXPECT_EQ(at(part, 1, 0), at(from, 0, 2));
  EXPECT_EQ(at(part, 2, 1), at(from, 1, 3));
  EXPECT_EQ(at(part, 1, 2), (std::array<std::uint8_t, 3>{9, 9, 9}));
}

TEST(Picture, ResizeKeepsMeanAndPlainColours) {
  Picture half = plain_picture(64, 64, {200, 0, 40});
  const Picture small = resize(half, 16, 8);
  EXPECT_EQ(small.width_px, 16);
  EXPECT_EQ(small.height_px, 8);
  EXPECT_EQ(small.rgb, plain_picture(16, 8, {200, 0, 40}).rgb);
  EXPECT_EQ(resize(half, 100, 90).rgb, plain_picture(100, 90, {200, 0, 40}).rgb);
  EXPECT_THROW(resize(half, 0, 5), Error);
  EXPECT_THROW(resize(Picture{}, 5, 5), Error);
}

}  // namespace
}  // namespace facet::render
