#include "animate_options.hpp"

#include <fmt/format.h>

#include <cerrno>
#include <cmath>
#include <cstdlib>

#include "facet/error.hpp"
#include "progress.hpp"
#include "report/take_pictures.hpp"
#include "stop_signals.hpp"
#include "tell.hpp"

namespace facet::tools {

void add_basis_options(Command command, BasisChoice& choice) {
  command.option("TAKE", choice.take, "Take whose faces are blended").required();
  command.option("--coarse-rank", choice.coarse_rank, "Directions in which the face's shape may vary")
      .shows_default()
      .range(1, animate::kMaxRank);
  command
      .option("--detail-rank", choice.detail_rank, "Directions in which wrinkles may vary; 0: smooth faces")
      .shows_default()
      .range(0, animate::kMaxRank);
  command.option("--basis", choice.file,
                 "Where the take's reduced basis is kept (default: NAME.basis beside NAME.take)");
}

std::shared_ptr<const animate::TakeBasis> open_basis(const BasisChoice& choice, const StopSignals& signals) {
  animate::BasisOptions options;
  options.coarse_rank = choice.coarse_rank;
  options.detail_rank = choice.detail_rank;
  options.file = choice.file;
  std::unique_ptr<Progress> progress;
  std::shared_ptr<const animate::TakeBasis> basis;
  try {
    basis = animate::TakeBasis::open(choice.take, options, [&](std::int64_t done, std::int64_t total) {
      if (progress == nullptr) {
        progress = std::make_unique<Progress>("Reducing", static_cast<std::uint64_t>(total));
      }
      progress->set(static_cast<std::uint64_t>(done));
      return signals.pending() == 0;
    });
  } catch (const Error&) {
    progress.reset();
    if (const int signal = signals.pending(); signal != 0) {
      tell(stderr, "facet: broken off while '{}' was reduced: nothing was written\n", choice.take);
      signals.die_of(signal);
    }
    throw;
  }
  progress.reset();
  const animate::BasisHeader& header = basis->header();
  tell(stderr,
       "{}: {} faces in {} + {} numbers; vertices within {:.3f} mm (rms {:.4f}), wrinkles within {:.3f} mm "
       "(rms {:.4f})\n",
       choice.take, header.frame_count, header.coarse_rank, header.detail_rank, header.coarse_max_mm,
       header.coarse_rms_mm, header.detail_max_mm, header.detail_rms_mm);
  if (header.left_out > 0) {
    tell(stderr, "note: {} frames without refinement are left out\n", header.left_out);
  }
  return basis;
}

void end_where_broken_off(const StopSignals& signals, const std::string& output) {
  if (const int signal = signals.pending(); signal != 0) {
    tell(stderr, "facet: broken off: nothing was written to '{}'\n", output);
    signals.die_of(signal);
  }
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

render::Picture draw_face(const mesh::MeshFrame& frame, const CameraIntrinsics& camera,
                          const mesh::Vertices& tints) {
  const report::FrameGeometry geometry = report::geometry_of(frame);
  const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
  mesh::Vertices colours = report::grey_shading(geometry.refined_normals);
  if (tints.cols() > 0) {
    colours = colours.cwiseProduct(tints).eval();
  }
  const render::Raycaster caster(geometry.refined_mm, triangles, render::Raycaster::Build::Quick);
  return report::render_colours(caster, triangles, colours, camera,
                                render::plain_picture(camera.width_px, camera.height_px, report::kPaper));
}

}  // namespace facet::tools
