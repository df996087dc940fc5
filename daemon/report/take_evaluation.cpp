#include "report/take_evaluation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <utility>

#include "facet/error.hpp"
#include "report/heat_map.hpp"
#include "report/take_pictures.hpp"
#include "simulation/sequence.hpp"

namespace facet::report {
namespace {

constexpr std::size_t kHeatMapRows = 4;

/// Indices in the take of frames that have a mesh and a truth; counts those with a truth but without a mesh.
std::vector<std::int64_t> frames_to_measure(take::TakeReader& take, const std::filesystem::path& truth,
                                            int& without_mesh) {
  std::vector<std::int64_t> frames;
  for (std::int64_t index = 0; index < take.frame_count(); ++index) {
    const take::FrameEntry entry = take.entry(index);
    if (!std::filesystem::exists(simulation::truth_file(truth, entry.sequence))) {
      continue;
    }
    if (entry.has_mesh) {
      frames.push_back(index);
    } else {
      ++without_mesh;
    }
  }
  if (frames.empty()) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format(
            "{} and {}: no frame has both a mesh and a truth; --truth is the folder that `facet synth` "
            "wrote, with truth/frame_000000.ply and so on",
            take.info().file.string(), truth.string()));
  }
  return frames;
}

}  // namespace

TakeEvaluation evaluate_take(take::TakeReader& take, const std::filesystem::path& folder, Alignment alignment,
                             const std::function<void(std::uint64_t done, std::uint64_t total)>& progress) {
  TakeEvaluation out;
  const auto frames = frames_to_measure(take, folder, out.without_mesh);
  const auto pictured = spread_evenly(frames, kHeatMapRows);
  std::unique_ptr<SourceImages> images;
  if (std::filesystem::exists(folder / "video.mkv")) {
    images = std::make_unique<SourceImages>(folder / "video.mkv");
  }

  FigureSum coarse_sum;
  FigureSum refined_sum;
  double scale_sum = 0;
  HeatMap heat_map;
  for (std::size_t done = 0; done < frames.size(); ++done) {
    const auto frame = take.frame(frames[done]);
    const Truth truth(simulation::read_truth_ply(simulation::truth_file(folder, frame->sequence)));
    FrameGeometry geometry = geometry_of(*frame);
    const auto measured = measured_vertices(*frame->subject, geometry.coarse_mm, geometry.coarse_normals);
    const Reconstruction coarse{std::move(geometry.coarse_mm), std::move(geometry.coarse_normals), measured};
    const Reconstruction refined{std::move(geometry.refined_mm), std::move(geometry.refined_normals),
                                 measured};
    const auto image = images ? images->at(frame->sequence) : std::nullopt;
    const auto rms = [&](const Reconstruction& mesh) {
      if (!image || !frame->albedo ||
          frame->albedo->linear_rgb.size() != static_cast<std::size_t>(mesh.vertices_mm.size())) {
        return std::numeric_limits<double>::quiet_NaN();
      }
      return photometric_rms(vertex_errors(mesh.vertices_mm, mesh.normals, frame->albedo->linear_rgb,
                                           frame->lighting, frame->camera, *image),
                             measured);
    };
    const Comparison coarse_errors = compare(coarse, truth, alignment);
    const Comparison refined_errors = compare(refined, truth, alignment);
    if (!frame->displacements_mm.empty()) {
      out.wrinkles.add(frame->subject->hierarchy->finest().one_rings, coarse,
                       true_displacements_mm(coarse, coarse_errors.truth_from_reconstruction, truth),
                       frame->displacements_mm);
    }
    const auto index = static_cast<std::int64_t>(frame->sequence);
    const FrameMeans coarse_means = coarse_sum.add(index, measured, coarse_errors, rms(coarse));
    const FrameMeans refined_means = refined_sum.add(index, measured, refined_errors, rms(refined));
    scale_sum += static_cast<double>(refined_errors.truth_from_reconstruction.scale);
    if (std::find(pictured.begin(), pictured.end(), frames[done]) != pictured.end()) {
      heat_map.add_row(*frame, image, coarse, coarse_errors, refined, refined_errors);
    }
    out.frames.push_back({frames[done], coarse_means, refined_means});
    progress(done + 1, frames.size());
  }
  out.coarse = coarse_sum.figures();
  out.refined = refined_sum.figures();
  out.points = refined_sum.point_count();
  out.mean_scale = scale_sum / static_cast<double>(frames.size());
  out.heat_map = heat_map.picture();
  return out;
}

}  // namespace facet::report
