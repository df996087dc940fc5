// `facet eval`: a take of a synthetic sequence against its truth.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "commands.hpp"
#include "evaluation.hpp"
#include "facet/error.hpp"
#include "heat_map.hpp"
#include "progress.hpp"
#include "simulation/sequence.hpp"
#include "take/export.hpp"
#include "take/reader.hpp"
#include "take_pictures.hpp"

namespace facet::tools {
namespace {

using nlohmann::ordered_json;

constexpr std::size_t kHeatMapRows = 4;

struct EvalOptions {
  std::string take;
  std::string truth;
  std::string align = "similarity";
  std::string output;
  std::string heat_map;
};

Alignment alignment_of(const std::string& name) {
  return name == "none" ? Alignment::None : name == "rigid" ? Alignment::Rigid : Alignment::Similarity;
}

ordered_json number(double value) {
  return std::isnan(value) ? ordered_json(nullptr) : ordered_json(value);
}

ordered_json figures_json(const Figures& figures) {
  return {{"mean_mm", number(figures.mean_mm)},
          {"std_mm", number(figures.std_mm)},
          {"median_mm", number(figures.median_mm)},
          {"p95_mm", number(figures.p95_mm)},
          {"normal_error_deg", number(figures.normal_error_deg)},
          {"flicker_mm", number(figures.flicker_mm)},
          {"photometric_rms", number(figures.photometric_rms)}};
}

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

void run_eval(const EvalOptions& options) {
  take::TakeReader take(options.take);
  const std::filesystem::path folder = options.truth;
  const Alignment alignment = alignment_of(options.align);
  int without_mesh = 0;
  const auto frames = frames_to_measure(take, folder, without_mesh);
  const auto pictured = spread_evenly(frames, kHeatMapRows);
  std::unique_ptr<SourceImages> images;
  if (std::filesystem::exists(folder / "video.mkv")) {
    images = std::make_unique<SourceImages>(folder / "video.mkv");
  }

  FigureSum coarse_sum;
  FigureSum refined_sum;
  double scale_sum = 0;
  HeatMap heat_map;
  Progress progress("Measuring", frames.size());
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
    const auto index = static_cast<std::int64_t>(frame->sequence);
    coarse_sum.add(index, measured, coarse_errors, rms(coarse));
    refined_sum.add(index, measured, refined_errors, rms(refined));
    scale_sum += static_cast<double>(refined_errors.truth_from_reconstruction.scale);
    if (std::find(pictured.begin(), pictured.end(), frames[done]) != pictured.end()) {
      heat_map.add_row(*frame, image, coarse, coarse_errors, refined, refined_errors);
    }
    progress.set(done + 1);
  }
  progress.finish();

  const Figures coarse = coarse_sum.figures();
  const Figures refined = refined_sum.figures();
  const ordered_json document = {
      {"take", options.take},
      {"truth", options.truth},
      {"align", options.align},
      {"frames", frames.size()},
      {"frames_without_mesh", without_mesh},
      {"points", refined_sum.point_count()},
      {"mean_scale", scale_sum / static_cast<double>(frames.size())},
      {"coarse", figures_json(coarse)},
      {"finest", figures_json(refined)},
      {"mean_change_percent", number(100 * (refined.mean_mm / coarse.mean_mm - 1))},
      {"normal_error_change_percent",
       number(100 * (refined.normal_error_deg / coarse.normal_error_deg - 1))}};
  const std::filesystem::path picture =
      options.heat_map.empty() ? std::filesystem::path(options.take).replace_extension(".eval.png")
                               : std::filesystem::path(options.heat_map);
  render::write_png(heat_map.picture(), picture);
  if (options.output.empty()) {
    fmt::print("{}\n", document.dump(2));
  } else {
    std::ofstream stream(options.output);
    stream << document.dump(2) << '\n';
    stream.close();
    if (!stream) {
      throw Error(ErrorKind::Storage, fmt::format("{}: cannot write", options.output));
    }
  }
  fmt::print(
      stderr,
      "{}: {} frames; mean {:.3f} mm (coarse {:.3f}), normals {:.2f} deg (coarse {:.2f}); heat map in {}\n",
      options.take, frames.size(), refined.mean_mm, coarse.mean_mm, refined.normal_error_deg,
      coarse.normal_error_deg, picture.string());
}

}  // namespace

void add_eval_command(CLI::App& app) {
  auto options = std::make_shared<EvalOptions>();
  CLI::App* command = app.add_subcommand(
      "eval", "Measure a take of a synthetic sequence against its truth (JSON and a heat map)");
  command->add_option("take", options->take, "Take file")->required();
  command->add_option("--truth", options->truth, "Folder that `facet synth` wrote")->required();
  command
      ->add_option("--align", options->align,
                   "What to take out of every frame first: none, rigid, or similarity (rigid and scale)")
      ->capture_default_str()
      ->check(CLI::IsMember({"none", "rigid", "similarity"}));
  command->add_option("-o,--output", options->output, "JSON to write; default: standard output");
  command->add_option("--heat-map", options->heat_map, "PNG to write; default: TAKE with .eval.png");
  command->callback([options] { run_eval(*options); });
}

}  // namespace facet::tools
