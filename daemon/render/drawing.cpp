#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <sstream>

#include "render/renderer.hpp"

namespace facet::render {
namespace {

/// Small text needs the doubled strokes to be legible; large text takes its weight from the line's width.
int font_of(int scale) {
  return scale == 1 ? cv::FONT_HERSHEY_DUPLEX : cv::FONT_HERSHEY_SIMPLEX;
}

constexpr double kFontScale = 0.42;  // capitals of 9 px in a line of 12
constexpr int kLineHeight_px = 12;
constexpr int kLineGap_px = 5;

/// Mixes a colour into one pixel; outside the picture nothing happens.
void blend(Picture& picture, int x, int y, std::array<std::uint8_t, 3> rgb, float opacity) {
  if (x < 0 || y < 0 || x >= picture.width_px || y >= picture.height_px || opacity <= 0) {
    return;
  }
  std::uint8_t* pixel =
      picture.rgb.data() + 3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(picture.width_px) +
                                static_cast<std::size_t>(x));
  const float part = std::min(opacity, 1.0F);
  for (std::size_t channel = 0; channel < 3; ++channel) {
    pixel[channel] = static_cast<std::uint8_t>(std::lround((1 - part) * static_cast<float>(pixel[channel]) +
                                                           part * static_cast<float>(rgb[channel])));
  }
}

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) {
    lines.push_back(line);
  }
  return lines;
}

}  // namespace

void draw_text(Picture& picture, int x_px, int y_px, const std::string& text, std::array<std::uint8_t, 3> rgb,
               int scale) {
  if (picture.rgb.empty()) {
    return;
  }
  cv::Mat onto(picture.height_px, picture.width_px, CV_8UC3, picture.rgb.data());
  int baseline_px = y_px + (kLineHeight_px - 2) * scale;
  for (const std::string& line : lines_of(text)) {
    cv::putText(onto, line, {x_px, baseline_px}, font_of(scale), kFontScale * scale,
                cv::Scalar(rgb[0], rgb[1], rgb[2]), scale, cv::LINE_AA);
    baseline_px += (kLineHeight_px + kLineGap_px) * scale;
  }
}

Eigen::Vector2i text_size_px(const std::string& text, int scale) {
  Eigen::Vector2i size{0, 0};
  for (const std::string& line : lines_of(text)) {
    int descent_px = 0;
    size.x() = std::max(size.x(),
                        cv::getTextSize(line, font_of(scale), kFontScale * scale, scale, &descent_px).width);
    size.y() += (size.y() > 0 ? kLineHeight_px + kLineGap_px : kLineHeight_px) * scale;
  }
  return size;
}

void draw_line(Picture& picture, Eigen::Vector2f a_px, Eigen::Vector2f b_px, std::array<std::uint8_t, 3> rgb,
               float opacity) {
  if (!a_px.allFinite() || !b_px.allFinite()) {
    return;
  }
  const Eigen::Vector2f between = b_px - a_px;
  const bool steep = std::abs(between.y()) > std::abs(between.x());
  const int along = steep ? 1 : 0;
  const int across = 1 - along;
  if (a_px[along] > b_px[along]) {
    std::swap(a_px, b_px);
  }
  const float length = b_px[along] - a_px[along];
  const float slope = length > 0 ? (b_px[across] - a_px[across]) / length : 0.0F;
  const auto limit = static_cast<float>(steep ? picture.height_px : picture.width_px);
  // Each step covers the two pixels across the line by their distance to it, the end pixels by their overlap.
  const float first = std::max(std::round(a_px[along]), 0.0F);
  const float last = std::min(std::round(b_px[along]), limit - 1);
  for (float at = first; at <= last; at += 1) {
    const float overlap = std::min(at + 0.5F, b_px[along]) - std::max(at - 0.5F, a_px[along]);
    const float strength = opacity * (length > 0 ? std::clamp(overlap, 0.0F, 1.0F) : 1.0F);
    const float centre = std::clamp(a_px[across] + slope * (at - a_px[along]), -2.0F, 1.0e6F);
    const float low = std::floor(centre);
    const auto step = static_cast<int>(at);
    const auto row = static_cast<int>(low);
    const float part = centre - low;
    blend(picture, steep ? row : step, steep ? step : row, rgb, strength * (1 - part));
    blend(picture, steep ? row + 1 : step, steep ? step : row + 1, rgb, strength * part);
  }
}

void draw_dot(Picture& picture, Eigen::Vector2f at_px, float radius_px, std::array<std::uint8_t, 3> rgb) {
  if (!at_px.allFinite() || !(radius_px > 0)) {
    return;
  }
  const auto bound = [](float value, int limit) {
    return static_cast<int>(std::clamp(value, 0.0F, static_cast<float>(limit)));
  };
  const float reach = radius_px + 1;
  for (int y = bound(at_px.y() - reach, picture.height_px);
       y < bound(at_px.y() + reach + 1, picture.height_px); ++y) {
    for (int x = bound(at_px.x() - reach, picture.width_px);
         x < bound(at_px.x() + reach + 1, picture.width_px); ++x) {
      const float distance = (Eigen::Vector2f(static_cast<float>(x), static_cast<float>(y)) - at_px).norm();
      blend(picture, x, y, rgb, std::clamp(radius_px + 0.5F - distance, 0.0F, 1.0F));
    }
  }
}

}  // namespace facet::render
