#include "report/sheet.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

#include "report/evaluation.hpp"

namespace facet::report {
namespace {

using Eigen::Vector3f;
using render::Picture;

constexpr int kCellWidth_px = 400;
constexpr int kCellHeight_px = 480;
constexpr int kGap_px = 6;
constexpr int kHeader_px = 46;
constexpr float kWireOpacity = 0.55F;
/// The photometric error, linear 0 to 1, that has the last colour of the scale, as in the paper's figures.
constexpr float kLargestError = 0.12F;
constexpr std::array<const char*, 6> kColumns{"input",           "coarse mesh", "refined normals",
                                              "refined, shaded", "albedo",      "photometric error"};

Picture cell_note(const std::string& text) {
  return note(text, kCellWidth_px, kCellHeight_px);
}

mesh::Vertices error_colours(const std::vector<float>& errors) {
  constexpr float kUnknown = 0.05F;
  mesh::Vertices colours(3, static_cast<Eigen::Index>(errors.size()));
  for (std::size_t v = 0; v < errors.size(); ++v) {
    const auto rgb = render::heat_colour(errors[v] / kLargestError);
    for (std::size_t channel = 0; channel < 3; ++channel) {
      colours(static_cast<Eigen::Index>(channel), static_cast<Eigen::Index>(v)) =
          std::isnan(errors[v]) ? kUnknown : render::srgb8_to_linear(rgb[channel]);
    }
  }
  return colours;
}

std::array<Picture, 6> make_row(const mesh::MeshFrame& frame, const std::optional<Frame>& image) {
  if (!mesh::has_mesh(frame)) {
    const std::string state = fmt::format("no mesh: {}", mesh::to_string(frame.state));
    Picture input = cell_note("image not available");
    if (image) {
      const auto width = static_cast<float>(image->width_px);
      const auto height = static_cast<float>(image->height_px);
      const float scale = std::min(kCellWidth_px / width, kCellHeight_px / height);
      input = render::plain_picture(kCellWidth_px, kCellHeight_px, {30, 32, 37});
      const Picture small =
          render::resize(render::to_picture(*image), std::max(1, static_cast<int>(scale * width)),
                         std::max(1, static_cast<int>(scale * height)));
      render::paste(input, small, (kCellWidth_px - small.width_px) / 2,
                    (kCellHeight_px - small.height_px) / 2);
    }
    return {input, cell_note(state), cell_note(state), cell_note(state), cell_note(state), cell_note(state)};
  }
  const FrameGeometry geometry = geometry_of(frame);
  const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
  const Cell cell = cell_around(face_vertices(frame), frame.camera, kCellWidth_px, kCellHeight_px);
  const Picture dark = render::plain_picture(kCellWidth_px, kCellHeight_px, {30, 32, 37});
  const render::Raycaster refined(geometry.refined_mm, triangles);

  const Picture input = image ? cell_picture(*image, cell) : cell_note("image not available");
  std::array<Picture, 6> row{input, draw_coarse_mesh(frame, cell, image ? input : dark, kWireOpacity)};
  row[2] = render_colours(refined, triangles, normal_colours(geometry.refined_normals), cell.camera, dark);
  row[3] = render_colours(refined, triangles, grey_shading(geometry.refined_normals), cell.camera, dark);
  row[4] = cell_note("albedo not learned yet");
  row[5] = cell_note(image ? "albedo not learned yet" : "image not available");
  const auto vertex_count = static_cast<std::size_t>(geometry.refined_mm.cols());
  if (frame.albedo && frame.albedo->linear_rgb.size() == 3 * vertex_count) {
    const mesh::Vertices albedo = Eigen::Map<const mesh::Vertices>(frame.albedo->linear_rgb.data(), 3,
                                                                   static_cast<Eigen::Index>(vertex_count));
    row[4] = render_colours(refined, triangles, albedo, cell.camera, dark);
    if (image) {
      const auto errors = vertex_errors(geometry.refined_mm, geometry.refined_normals,
                                        frame.albedo->linear_rgb, frame.lighting, frame.camera, *image);
      row[5] = render_colours(refined, triangles, error_colours(errors), cell.camera, dark);
    }
  }
  if (frame.displacements_mm.empty()) {
    for (const std::size_t column : {std::size_t{2}, std::size_t{3}}) {
      render::draw_text(row[column], 10, kCellHeight_px - 20, "not refined: coarse mesh", {255, 190, 90});
    }
  }
  return row;
}

}  // namespace

Picture make_sheet(take::TakeReader& take, const std::vector<std::int64_t>& frames, SourceImages* images,
                   const std::function<void(int)>& done) {
  const int columns = static_cast<int>(kColumns.size());
  const int rows = static_cast<int>(frames.size());
  Picture sheet = render::plain_picture(columns * kCellWidth_px + (columns + 1) * kGap_px,
                                        kHeader_px + rows * (kCellHeight_px + kGap_px), kPaper);
  for (int column = 0; column < columns; ++column) {
    const int x = kGap_px + column * (kCellWidth_px + kGap_px);
    render::draw_text(sheet, x + 4, 16, kColumns[static_cast<std::size_t>(column)], kInk);
    if (column == columns - 1) {
      constexpr int kScale_px = 150;
      draw_scale(sheet, x + kCellWidth_px - kScale_px - 4, 10, kScale_px, "0",
                 fmt::format("{}", kLargestError));
    }
  }
  for (int row = 0; row < rows; ++row) {
    const auto frame = take.frame(frames[static_cast<std::size_t>(row)]);
    const auto cells = make_row(*frame, images != nullptr ? images->at(frame->sequence) : std::nullopt);
    const int y = kHeader_px + row * (kCellHeight_px + kGap_px);
    for (int column = 0; column < columns; ++column) {
      render::paste(sheet, cells[static_cast<std::size_t>(column)],
                    kGap_px + column * (kCellWidth_px + kGap_px), y);
    }
    std::string label =
        fmt::format("frame {}  {:.2f} s", frame->sequence, static_cast<double>(frame->media_time_ns) * 1e-9);
    if (mesh::has_mesh(*frame)) {
      label += fmt::format("  rms {:.4f}", frame->photometric_rms);
    }
    label_cell(sheet, kGap_px, y + kCellHeight_px, label);
    done(row + 1);
  }
  return sheet;
}

}  // namespace facet::report
