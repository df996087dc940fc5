#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "render/renderer.hpp"

namespace facet::render {
namespace {

constexpr std::array<std::uint8_t, 3> kWhite{255, 255, 255};

double ink(const Picture& picture) {
  return std::accumulate(picture.rgb.begin(), picture.rgb.end(), 0.0) / (3 * 255.0);
}

TEST(DrawText, LeavesInkInsideItsBox) {
  for (const int scale : {1, 2, 3}) {
    const auto size = text_size_px("Albedo 0.25\nsecond", scale);
    Picture picture = plain_picture(300 * scale, 60 * scale, {0, 0, 0});
    draw_text(picture, 10, 12, "Albedo 0.25\nsecond", kWhite, scale);
    EXPECT_GT(ink(picture), 100 * scale);
    Picture inside = plain_picture(picture.width_px, picture.height_px, {0, 0, 0});
    // Descenders and the soft edge reach past the box by a few pixels.
    const int margin = 4 * scale;
    paste(inside, crop(picture, 10 - margin, 12 - margin, size.x() + 2 * margin, size.y() + 2 * margin),
          10 - margin, 12 - margin);
    EXPECT_EQ(inside.rgb, picture.rgb);
  }
}

TEST(DrawText, WiderTextTakesMoreRoom) {
  EXPECT_GT(text_size_px("wide text").x(), text_size_px("text").x());
  EXPECT_GT(text_size_px("a\nb").y(), text_size_px("a").y());
  EXPECT_EQ(text_size_px("").x(), 0);
}

TEST(DrawText, IsCutOutsideThePicture) {
  Picture picture = plain_picture(20, 20, {0, 0, 0});
  draw_text(picture, -500, -500, "far away", kWhite);
  EXPECT_EQ(ink(picture), 0);
  Picture empty;
  draw_text(empty, 0, 0, "nothing to draw on", kWhite);
  EXPECT_TRUE(empty.rgb.empty());
}

TEST(DrawLine, CarriesItsLengthInInk) {
  for (const auto& end : {Eigen::Vector2f(60, 10), Eigen::Vector2f(60, 35), Eigen::Vector2f(20, 62)}) {
    Picture forth = plain_picture(80, 80, {0, 0, 0});
    draw_line(forth, {10.25F, 10}, end, kWhite);
    Picture back = plain_picture(80, 80, {0, 0, 0});
    draw_line(back, end, {10.25F, 10}, kWhite);
    const Eigen::Vector2f between = end - Eigen::Vector2f(10.25F, 10);
    EXPECT_NEAR(ink(forth), between.cwiseAbs().maxCoeff(), 1.0);
    EXPECT_EQ(forth.rgb, back.rgb);
    Picture faint = plain_picture(80, 80, {0, 0, 0});
    draw_line(faint, {10.25F, 10}, end, kWhite, 0.5F);
    EXPECT_NEAR(ink(faint), 0.5 * ink(forth), 1.0);
  }
}

TEST(DrawLine, IsCutOutsideThePicture) {
  Picture picture = plain_picture(20, 20, {0, 0, 0});
  draw_line(picture, {-1e6F, 10}, {1e6F, 10}, kWhite);
  EXPECT_NEAR(ink(picture), 20, 0.1);
  draw_line(picture, {-50, -50}, {-5, 300}, kWhite);
  draw_line(picture, {NAN, 0}, {5, 5}, kWhite);
  EXPECT_NEAR(ink(picture), 20, 0.1);
}

TEST(DrawDot, HasItsArea) {
  Picture picture = plain_picture(40, 40, {0, 0, 0});
  draw_dot(picture, {20.3F, 19.6F}, 5, kWhite);
  EXPECT_NEAR(ink(picture), M_PI * 25, 2);
  draw_dot(picture, {-100, 4}, 5, kWhite);
  draw_dot(picture, {1e9F, 4}, 5, kWhite);
  draw_dot(picture, {NAN, 4}, 5, kWhite);
  EXPECT_NEAR(ink(picture), M_PI * 25, 2);
}

}  // namespace
}  // namespace facet::render
