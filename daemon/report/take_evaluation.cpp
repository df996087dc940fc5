#include "report/take_evaluation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <utility>

#include "facet/error.hpp"
#include "report/heat_map.hpp"
#include "report/take_pictures.hpp"
#include "report/truth_folder.hpp"

namespace facet::report {
namespace {

constexpr std::size_t kHeatMapRows = 4;

/// Indices in the take of frames that have a mesh and a truth; counts those with a truth but without a mesh.
std::vector<std::int64_t> frames_to_measure(take::TakeReader& take, const TruthFolder& truth,
                                            const std::vector<std::int64_t>& wanted, int& without_mesh) {
  std::vector<std::int64_t> all(static_cast<std::size_t>(take.frame_count()));
  std::iota(all.begin(), all.end(), std::int64_t{0});
  std::vector<std::int64_t> frames;
  std::size_t met = 0;
  for (const std::int64_t index : wanted.empty() ? all : wanted) {
    const take::FrameEntry entry = take.entry(index);
    if (!truth.has(entry.sequence)) {
      continue;
    }
    ++met;
    if (entry.has_mesh) {
      frames.push_back(index);
    } else {
      ++without_mesh;
    }
  }
  const std::vector<std::uint64_t> numbers = truth.frames();
  const auto refuse = [&](const std::string& why) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{} and {}: {}", take.info().file.string(), truth.folder().string(), why));
  };
  if (frames.empty()) {
    refuse(
        fmt::format("no frame has both a mesh and a truth; the truth has frames {} to {}, {} of them in "
                    "the take, without a mesh",
                    numbers.front(), numbers.back(), met));
  }
  if (wanted.empty() && met < numbers.size()) {
    refuse(
        fmt::format("the truth has {} frames, {} to {}, of which the take has {}, {} to {}: of another "
                    "video? --frames {}:{} measures what both have",
                    numbers.size(), numbers.front(), numbers.back(), met, take.entry(0).sequence,
                    take.entry(take.frame_count() - 1).sequence, take.entry(frames.front()).sequence,
                    take.entry(frames.back()).sequence + 1));
  }
  return frames;
}

}  // namespace

TakeEvaluation evaluate_take(take::TakeReader& take, const std::filesystem::path& folder,
                             const EvaluationOptions& options,
                             const std::function<void(std::uint64_t done, std::uint64_t total)>& progress) {
  TakeEvaluation out;
  const TruthFolder truths(folder, options.mm_per_unit);
  const auto frames = frames_to_measure(take, truths, options.frames, out.without_mesh);
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
    const Truth truth(truths.mesh(frame->sequence));
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
    const Comparison coarse_errors = compare(coarse, truth, options.alignment);
    const Comparison refined_errors = compare(refined, truth, options.alignment);
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
