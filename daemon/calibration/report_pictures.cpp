#include "calibration/report_pictures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace facet::calibration {
namespace {

constexpr int kTileWidth_px = 480;
constexpr int kGap_px = 8;
constexpr int kTitle_px = 24;
using Colour = std::array<std::uint8_t, 3>;
constexpr Colour kPaper = {24, 24, 28};
constexpr Colour kInk = {235, 235, 235};

/// Tiles of pictures with titles, up to three in a row.
class Sheet {
 public:
  Sheet(std::size_t count, int tile_height_px) : columns_(static_cast<int>(std::min<std::size_t>(count, 3))) {
    const int rows = (static_cast<int>(count) + columns_ - 1) / columns_;
    row_px_ = tile_height_px + kTitle_px + kGap_px;
    picture_ = render::plain_picture(columns_ * (kTileWidth_px + kGap_px) + kGap_px, rows * row_px_ + kGap_px,
                                     kPaper);
  }
  /// The tile's top left corner; its title is drawn.
  Eigen::Vector2i place(std::size_t index, const std::string& title) {
    const int column = static_cast<int>(index) % columns_;
    const int row = static_cast<int>(index) / columns_;
    Eigen::Vector2i at(kGap_px + column * (kTileWidth_px + kGap_px), kGap_px + row * row_px_ + kTitle_px);
    render::draw_text(picture_, at.x(), at.y() - kTitle_px + 2, title, kInk, 1);
    return at;
  }
  render::Picture& picture() { return picture_; }

 private:
  int columns_;
  int row_px_;
  render::Picture picture_;
};

int tile_height(int width_px, int height_px) {
  return static_cast<int>(std::lround(static_cast<double>(kTileWidth_px) * height_px / width_px));
}

}  // namespace

render::Picture coverage_picture(const std::vector<std::string>& names,
                                 const std::vector<Coverage>& coverage) {
  int tallest = 0;
  for (const Coverage& one : coverage) {
    tallest = std::max(tallest, tile_height(one.width_px(), one.height_px()));
  }
  Sheet sheet(coverage.size(), tallest);
  for (std::size_t i = 0; i < coverage.size(); ++i) {
    const Coverage& one = coverage[i];
    const Eigen::Vector2i at =
        sheet.place(i, fmt::format("{}: {:.0f} % of the picture covered", names[i], 100 * one.part()));
    const int height = tile_height(one.width_px(), one.height_px());
    int most = 1;
    for (int row = 0; row < Coverage::kRows; ++row) {
      for (int column = 0; column < Coverage::kColumns; ++column) {
        most = std::max(most, one.count(column, row));
      }
    }
    for (int row = 0; row < Coverage::kRows; ++row) {
      for (int column = 0; column < Coverage::kColumns; ++column) {
        const int count = one.count(column, row);
        const int left = kTileWidth_px * column / Coverage::kColumns;
        const int right = kTileWidth_px * (column + 1) / Coverage::kColumns;
        const int top = height * row / Coverage::kRows;
        const int bottom = height * (row + 1) / Coverage::kRows;
        const float part = std::sqrt(static_cast<float>(count) / static_cast<float>(most));
        const Colour colour = count == 0 ? Colour{70, 20, 20} : render::heat_colour(0.25F + 0.75F * part);
        render::paste(sheet.picture(), render::plain_picture(right - left - 1, bottom - top - 1, colour),
                      at.x() + left, at.y() + top);
        const Colour ink = part > 0.6F ? Colour{20, 20, 20} : kInk;
        const std::string text = fmt::format("{}", count);
        const Eigen::Vector2i size = render::text_size_px(text);
        render::draw_text(sheet.picture(), at.x() + (left + right - size.x()) / 2,
                          at.y() + (top + bottom - size.y()) / 2, text, ink);
      }
    }
  }
  return std::move(sheet.picture());
}

double fitting_exaggeration(const Calibration& calibration) {
  const double width = calibration.rig.cameras.empty() ? 640 : calibration.rig.cameras[0].lens.width_px;
  const double wanted = width / 60 / std::max(calibration.rms_px, 1e-6);
  const double power = std::pow(10, std::floor(std::log10(wanted)));
  const double part = wanted / power;
  return std::max(1.0, power * (part < 2 ? 1 : part < 5 ? 2 : 5));
}

render::Picture error_picture(const Calibration& calibration, double exaggeration) {
  int tallest = 0;
  for (const capture::RigCamera& camera : calibration.rig.cameras) {
    tallest = std::max(tallest, tile_height(camera.lens.width_px, camera.lens.height_px));
  }
  Sheet sheet(calibration.rig.cameras.size(), tallest);
  for (std::size_t i = 0; i < calibration.rig.cameras.size(); ++i) {
    const capture::Lens& lens = calibration.rig.cameras[i].lens;
    const double scale = static_cast<double>(kTileWidth_px) / lens.width_px;
    const Eigen::Vector2i at =
        sheet.place(i, fmt::format("{}: {:.3f} px (rms), lines {:g} x as long", calibration.cameras[i].name,
                                   calibration.cameras[i].rms_px, exaggeration));
    render::Picture tile =
        render::plain_picture(kTileWidth_px, tile_height(lens.width_px, lens.height_px), {10, 10, 12});
    for (const CornerError& error : calibration.errors) {
      if (error.camera != i) {
        continue;
      }
      const Eigen::Vector2f from = (scale * (error.px.array() + 0.5)).cast<float>();
      const Eigen::Vector2f way = (scale * exaggeration * error.error_px).cast<float>();
      // Its colour is its direction, so that a pattern is seen at once.
      const double angle = std::atan2(error.error_px.y(), error.error_px.x());
      const auto channel = [&](double shift) {
        return static_cast<std::uint8_t>(std::lround(150 + 105 * std::cos(angle - shift)));
      };
      render::draw_line(tile, from, from + way, {channel(0), channel(2.0944), channel(4.1888)}, 0.9F);
    }
    render::paste(sheet.picture(), tile, at.x(), at.y());
  }
  return std::move(sheet.picture());
}

}  // namespace facet::calibration
