#include "report/heat_map.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "report/take_pictures.hpp"

namespace facet::report {
namespace {

using render::Picture;

constexpr int kCellWidth_px = 360;
constexpr int kCellHeight_px = 430;
constexpr int kGap_px = 6;
constexpr int kHeader_px = 46;
constexpr float kLargest_mm = 4;
constexpr float kLargest_deg = 30;
constexpr std::array<const char*, 5> kColumns{"input", "distance, coarse", "distance, refined",
                                              "normals, coarse", "normals, refined"};

/// Measured vertices in heat colours over the grey shaded mesh.
Picture heat_cell(const Reconstruction& mesh, const mesh::Triangles& triangles,
                  const std::vector<float>& values, float largest, const CameraIntrinsics& camera) {
  mesh::Vertices colours = 0.25F * grey_shading(mesh.normals);
  for (std::size_t k = 0; k < mesh.measured.size(); ++k) {
    const auto rgb = render::heat_colour(std::abs(values[k]) / largest);
    for (std::size_t channel = 0; channel < 3; ++channel) {
      colours(static_cast<Eigen::Index>(channel), mesh.measured[k]) = render::srgb8_to_linear(rgb[channel]);
    }
  }
  const render::Raycaster caster(mesh.vertices_mm, triangles);
  return render_colours(caster, triangles, colours, camera,
                        render::plain_picture(kCellWidth_px, kCellHeight_px, {30, 32, 37}));
}

}  // namespace

void HeatMap::add_row(const mesh::MeshFrame& frame, const std::optional<Frame>& image,
                      const Reconstruction& coarse, const Comparison& coarse_errors,
                      const Reconstruction& refined, const Comparison& refined_errors) {
  const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
  mesh::Vertices measured(3, static_cast<Eigen::Index>(coarse.measured.size()));
  for (std::size_t k = 0; k < coarse.measured.size(); ++k) {
    measured.col(static_cast<Eigen::Index>(k)) = coarse.vertices_mm.col(coarse.measured[k]);
  }
  const Cell cell = cell_around(measured, frame.camera, kCellWidth_px, kCellHeight_px);
  Picture input =
      image ? cell_picture(*image, cell) : render::plain_picture(kCellWidth_px, kCellHeight_px, {30, 32, 37});
  if (!image) {
    render::draw_text(input, 100, kCellHeight_px / 2, "image not available", kFaintInk);
  }
  render::draw_text(input, 8, kCellHeight_px - 18, fmt::format("frame {}", frame.sequence), kInk);
  cells_.push_back(std::move(input));
  cells_.push_back(heat_cell(coarse, triangles, coarse_errors.signed_distance_mm, kLargest_mm, cell.camera));
  cells_.push_back(
      heat_cell(refined, triangles, refined_errors.signed_distance_mm, kLargest_mm, cell.camera));
  cells_.push_back(heat_cell(coarse, triangles, coarse_errors.normal_error_deg, kLargest_deg, cell.camera));
  cells_.push_back(heat_cell(refined, triangles, refined_errors.normal_error_deg, kLargest_deg, cell.camera));
}

render::Picture HeatMap::picture() const {
  const int columns = static_cast<int>(kColumns.size());
  const int rows = static_cast<int>(cells_.size()) / columns;
  Picture picture = render::plain_picture(columns * (kCellWidth_px + kGap_px) + kGap_px,
                                          kHeader_px + rows * (kCellHeight_px + kGap_px), kPaper);
  for (int column = 0; column < columns; ++column) {
    const int x = kGap_px + column * (kCellWidth_px + kGap_px);
    render::draw_text(picture, x + 4, 16, kColumns[static_cast<std::size_t>(column)], kInk);
    constexpr int kScale_px = 140;
    if (column > 0) {
      draw_scale(picture, x + kCellWidth_px - kScale_px - 4, 10, kScale_px, "0",
                 column < 3 ? fmt::format("{} mm", kLargest_mm) : fmt::format("{} deg", kLargest_deg));
    }
    for (int row = 0; row < rows; ++row) {
      render::paste(
          picture, cells_[static_cast<std::size_t>(row) * kColumns.size() + static_cast<std::size_t>(column)],
          x, kHeader_px + row * (kCellHeight_px + kGap_px));
    }
  }
  return picture;
}

}  // namespace facet::report
