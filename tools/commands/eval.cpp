// `facet eval`: a take against its truth.

#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "report/take_evaluation.hpp"
#include "take/reader.hpp"
#include "take_frames.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using nlohmann::ordered_json;

struct EvalOptions {
  std::string take;
  std::string truth;
  std::string align = "similarity";
  std::string unit = "mm";
  std::string frames;
  std::string output;
  std::string heat_map;
};

report::Alignment alignment_of(const std::string& name) {
  return name == "none"    ? report::Alignment::None
         : name == "rigid" ? report::Alignment::Rigid
                           : report::Alignment::Similarity;
}

float mm_per_unit(const std::string& unit) {
  return unit == "m" ? 1000.0F : unit == "cm" ? 10.0F : 1.0F;
}

ordered_json number(double value) {
  return std::isnan(value) ? ordered_json(nullptr) : ordered_json(value);
}

ordered_json figures_json(const report::AccuracyFigures& figures) {
  return {{"mean_mm", number(figures.mean_mm)},
          {"std_mm", number(figures.std_mm)},
          {"median_mm", number(figures.median_mm)},
          {"p95_mm", number(figures.p95_mm)},
          {"normal_error_deg", number(figures.normal_error_deg)},
          {"flicker_mm", number(figures.flicker_mm)},
          {"photometric_rms", number(figures.photometric_rms)}};
}

void run_eval(const EvalOptions& options) {
  take::TakeReader take(options.take);
  std::optional<Progress> progress;
  const report::TakeEvaluation evaluation =
      report::evaluate_take(take, options.truth,
                            {.alignment = alignment_of(options.align),
                             .mm_per_unit = mm_per_unit(options.unit),
                             .frames = options.frames.empty() ? std::vector<std::int64_t>()
                                                              : frames_in_range(take, options.frames)},
                            [&](std::uint64_t done, std::uint64_t total) {
                              if (!progress) {
                                progress.emplace("Measuring", total);
                              }
                              progress->set(done);
                            });
  progress.reset();
  const report::AccuracyFigures& coarse = evaluation.coarse;
  const report::AccuracyFigures& refined = evaluation.refined;
  const ordered_json document = {
      {"take", options.take},
      {"truth", options.truth},
      {"align", options.align},
      {"frames", evaluation.frames.size()},
      {"frames_without_mesh", evaluation.without_mesh},
      {"points", evaluation.points},
      {"mean_scale", evaluation.mean_scale},
      {"coarse", figures_json(coarse)},
      {"finest", figures_json(refined)},
      {"wrinkle_correlation", number(evaluation.wrinkles.correlation())},
      {"wrinkle_depth", number(evaluation.wrinkles.depth())},
      {"wrinkle_points", evaluation.wrinkles.point_count()},
      {"mean_change_percent", number(100 * (refined.mean_mm / coarse.mean_mm - 1))},
      {"normal_error_change_percent",
       number(100 * (refined.normal_error_deg / coarse.normal_error_deg - 1))}};
  const std::filesystem::path picture =
      options.heat_map.empty() ? std::filesystem::path(options.take).replace_extension(".eval.png")
                               : std::filesystem::path(options.heat_map);
  render::write_png(evaluation.heat_map, picture);
  if (options.output.empty()) {
    std::puts(document.dump(2, ' ', true).c_str());
  } else {
    files::OutputFile output(options.output);
    output.write(document.dump(2) + "\n");
    output.commit();
  }
  tell(
      stderr,
      "{}: {} frames; mean {:.3f} mm (coarse {:.3f}), normals {:.2f} deg (coarse {:.2f}), wrinkles correlate "
      "by {:.2f}; heat map in {}\n",
      options.take, evaluation.frames.size(), refined.mean_mm, coarse.mean_mm, refined.normal_error_deg,
      coarse.normal_error_deg, evaluation.wrinkles.correlation(), picture.string());
}

}  // namespace

void add_eval_command(Command app) {
  auto options = std::make_shared<EvalOptions>();
  const Command command = app.subcommand(
      "eval", "Measure a take against its truth, rendered or from elsewhere (JSON and a heat map)");
  command.option("take", options->take, "Take file").required();
  command.option("--truth", options->truth, "Folder with truth/frame_NNNNNN.ply, as `facet synth` writes it")
      .required();
  command
      .option("--align", options->align,
              "What to take out of every frame first: none, rigid, or similarity (rigid and scale)")
      .shows_default()
      .one_of({"none", "rigid", "similarity"});
  command.option("--unit", options->unit, "Of the truth's lengths").shows_default().one_of({"mm", "cm", "m"});
  command.option("--frames", options->frames, kFramesHelp);
  command.option("-o,--output", options->output, "JSON to write; default: standard output");
  command.option("--heat-map", options->heat_map, "PNG to write; default: TAKE with .eval.png");
  command.callback([options] { run_eval(*options); });
}

}  // namespace facet::tools
