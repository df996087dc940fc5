#include "animate_options.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <cmath>
#include <cstdlib>

#include "facet/error.hpp"
#include "progress.hpp"
#include "stop_signals.hpp"
#include "take_pictures.hpp"

namespace facet::tools {

void add_basis_options(CLI::App& command, BasisChoice& choice) {
  command.add_option("TAKE", choice.take, "Take whose faces are blended")->required();
  command.add_option("--coarse-rank", choice.coarse_rank, "Directions in which the face's shape may vary")
      ->capture_default_str()
      ->check(CLI::Range(1, animate::kMaxRank));
  command
      .add_option("--detail-rank", choice.detail_rank,
                  "Directions in which wrinkles may vary; 0: smooth faces")
      ->capture_default_str()
      ->check(CLI::Range(0, animate::kMaxRank));
  command.add_option("--basis", choice.file,
                     "Where the take's reduced basis is kept (default: NAME.basis beside NAME.take)");
}

std::shared_ptr<const animate::TakeBasis> open_basis(const BasisChoice& choice, const StopSignals& signals) {
  animate::BasisOptions options;
  options.coarse_rank = choice.coarse_rank;
  options.detail_rank = choice.detail_rank;
  options.file = choice.file;
  std::unique_ptr<Progress> progress;
  int signal = 0;
  std::shared_ptr<const animate::TakeBasis> basis;
  try {
    basis = animate::TakeBasis::open(choice.take, options, [&](std::int64_t done, std::int64_t total) {
      if (progress == nullptr) {
        progress = std::make_unique<Progress>("Reducing", static_cast<std::uint64_t>(total));
      }
      progress->set(static_cast<std::uint64_t>(done));
      signal = signals.pending();
      return signal == 0;
    });
  } catch (const Error&) {
    progress.reset();
    if (signal != 0) {
      signals.die_of(signal);
    }
    throw;
  }
  progress.reset();
  const animate::BasisHeader& header = basis->header();
  fmt::print(
      stderr,
      "{}: {} faces in {} + {} numbers; vertices within {:.3f} mm (rms {:.4f}), wrinkles within {:.3f} mm "
      "(rms {:.4f})\n",
      choice.take, header.frame_count, header.coarse_rank, header.detail_rank, header.coarse_max_mm,
      header.coarse_rms_mm, header.detail_max_mm, header.detail_rms_mm);
  if (header.left_out > 0) {
    fmt::print(stderr, "note: {} frames without refinement are left out\n", header.left_out);
  }
  return basis;
}

std::vector<float> parse_numbers(const std::string& option, const std::string& text, std::size_t count) {
  std::vector<float> numbers;
  const char* at = text.c_str();
  while (*at != '\0') {
    char* end = nullptr;
    const float number = std::strtof(at, &end);
    if (end == at || !std::isfinite(number) || (*end != ',' && *end != '\0')) {
      break;
    }
    numbers.push_back(number);
    at = *end == ',' ? end + 1 : end;
  }
  if (*at != '\0' || numbers.size() != count || text.back() == ',') {
    throw Error(ErrorKind::Usage,
                fmt::format("{}: '{}' is not {} numbers with commas between them", option, text, count));
  }
  return numbers;
}

render::Picture draw_face(const mesh::MeshFrame& frame, const mesh::Vertices& colours, int width_px,
                          int height_px) {
  const FrameGeometry geometry = geometry_of(frame);
  const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
  const Cell cell = cell_around(face_vertices(frame), frame.camera, width_px, height_px);
  const render::Raycaster caster(geometry.refined_mm, triangles, render::Raycaster::Build::Quick);
  return render_colours(caster, triangles, colours, cell.camera,
                        render::plain_picture(width_px, height_px, kPaper));
}

render::Picture draw_face(const mesh::MeshFrame& frame, int width_px, int height_px) {
  return draw_face(frame, grey_shading(geometry_of(frame).refined_normals), width_px, height_px);
}

}  // namespace facet::tools
