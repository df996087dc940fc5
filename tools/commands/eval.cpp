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
  std::string model;
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
  return std::isfinite(value) ? ordered_json(value) : ordered_json(nullptr);
}

double change_percent(double refined, double coarse) {
  constexpr double kPercent = 100;
  return kPercent * (refined / coarse - 1);
}

ordered_json accuracy_json(const report::AccuracyFigures& figures) {
  return {{"mean_mm", number(figures.mean_mm)},
          {"std_mm", number(figures.std_mm)},
          {"median_mm", number(figures.median_mm)},
          {"p95_mm", number(figures.p95_mm)},
          {"normal_error_deg", number(figures.normal_error_deg)},
          {"flicker_mm", number(figures.flicker_mm)},
          {"photometric_rms", number(figures.photometric_rms)}};
}

ordered_json skin_json(const report::SkinPointFigures& figures) {
  return {{"mean_mm", number(figures.mean_mm)},
          {"p95_mm", number(figures.p95_mm)},
          {"tangential_mm", number(figures.tangential_mm)},
          {"first_fifth_mm", number(figures.first_fifth_mm)},
          {"last_fifth_mm", number(figures.last_fifth_mm)},
          {"drift_mm", number(figures.drift_mm())},
          {"slope_mm_per_10_s", number(figures.slope_mm_per_10_s)},
          {"points", figures.points}};
}

/// Accuracy and skin points of a kind of mesh.
ordered_json mesh_json(const report::MeshFigures& figures) {
  ordered_json json = accuracy_json(figures.whole);
  json["skin_point"] = skin_json(figures.skin);
  return json;
}

ordered_json part_json(const report::MeshFigures& figures, std::size_t part) {
  const report::AccuracyFigures& accuracy = figures.parts[part];
  return {{"mean_mm", number(accuracy.mean_mm)},
          {"p95_mm", number(accuracy.p95_mm)},
          {"normal_error_deg", number(accuracy.normal_error_deg)},
          {"flicker_mm", number(accuracy.flicker_mm)},
          {"skin_point_mm", number(figures.part_skin_mm[part])}};
}

ordered_json bands_json(const report::BandSums& bands) {
  ordered_json json;
  for (std::size_t b = 0; b < bands.size(); ++b) {
    json[report::kBandNames[b]] = {{"points", bands[b].point_count()},
                                   {"correlation", number(bands[b].correlation())},
                                   {"depth", number(bands[b].depth())},
                                   {"coarse_rms_mm", number(bands[b].true_rms())},
                                   {"finest_rms_mm", number(bands[b].error_rms())}};
  }
  return json;
}

ordered_json regions_json(const report::TakeEvaluation& evaluation) {
  if (!evaluation.has_parts) {
    return nullptr;
  }
  ordered_json json;
  for (std::size_t part = 0; part < report::kFaceParts; ++part) {
    ordered_json one = {{"coarse", part_json(evaluation.by_frame.coarse, part)},
                        {"finest", part_json(evaluation.by_frame.refined, part)},
                        {"sequence",
                         {{"coarse", part_json(evaluation.by_sequence.coarse, part)},
                          {"finest", part_json(evaluation.by_sequence.refined, part)}}}};
    one["neutral"] = nullptr;
    if (evaluation.neutral) {
      const report::AccuracyFigures& at_rest = evaluation.neutral->face.parts[part];
      one["neutral"] = {{"mean_mm", number(at_rest.mean_mm)},
                        {"p95_mm", number(at_rest.p95_mm)},
                        {"normal_error_deg", number(at_rest.normal_error_deg)}};
    }
    one["bands"] = bands_json(evaluation.part_bands[part]);
    json[face::kFacePartNames[part]] = std::move(one);
  }
  return json;
}

ordered_json neutral_json(const report::TakeEvaluation& evaluation) {
  if (!evaluation.neutral) {
    return nullptr;
  }
  const report::AccuracyFigures& figures = evaluation.neutral->face.whole;
  return {{"scale", evaluation.neutral->scale}, {"mean_mm", number(figures.mean_mm)},
          {"std_mm", number(figures.std_mm)},   {"median_mm", number(figures.median_mm)},
          {"p95_mm", number(figures.p95_mm)},   {"normal_error_deg", number(figures.normal_error_deg)}};
}

ordered_json expressions_json(const std::vector<report::WeightFigures>& weights) {
  if (weights.empty()) {
    return nullptr;
  }
  const report::WeightSummary summary = report::summary_of(weights);
  ordered_json dead = ordered_json::array();
  ordered_json by_name;
  for (const report::WeightFigures& one : weights) {
    by_name[one.name] = {{"moves", one.moves},
                         {"correlation", number(one.correlation)},
                         {"slope", number(one.slope)},
                         {"mean_error", number(one.mean_error)},
                         {"rest_offset", number(one.rest_offset)}};
    if (one.is_dead) {
      dead.push_back(one.name);
    }
  }
  return {{"moving", summary.moving},
          {"correlation_0.9", summary.well},
          {"correlation_0.65", summary.fairly},
          {"median_slope", number(summary.median_slope)},
          {"mean_error", number(summary.mean_error)},
          {"dead", std::move(dead)},
          {"weights", std::move(by_name)}};
}

ordered_json pose_json(const report::PoseFigures& pose) {
  return {{"frames", pose.frames},
          {"rotation_deg", number(pose.rotation_deg)},
          {"rotation_p95_deg", number(pose.rotation_p95_deg)},
          {"translation_mm", number(pose.translation_mm)},
          {"translation_p95_mm", number(pose.translation_p95_mm)},
          {"depth_mm", number(pose.depth_mm)},
          {"focal_percent", number(pose.focal_percent)}};
}

ordered_json document_of(const EvalOptions& options, const report::TakeEvaluation& evaluation) {
  const report::MeshFigures& coarse = evaluation.by_frame.coarse;
  const report::MeshFigures& refined = evaluation.by_frame.refined;
  const report::FieldSum& wrinkles = evaluation.bands.back();
  return {{"take", options.take},
          {"truth", options.truth},
          {"align", options.align},
          {"frames", evaluation.frames.size()},
          {"frames_without_mesh", evaluation.without_mesh},
          {"points", evaluation.points},
          {"mean_scale", evaluation.by_frame.scale},
          {"coarse", mesh_json(coarse)},
          {"finest", mesh_json(refined)},
          {"wrinkle_correlation", number(wrinkles.correlation())},
          {"wrinkle_depth", number(wrinkles.depth())},
          {"wrinkle_points", wrinkles.point_count()},
          {"mean_change_percent", number(change_percent(refined.whole.mean_mm, coarse.whole.mean_mm))},
          {"normal_error_change_percent",
           number(change_percent(refined.whole.normal_error_deg, coarse.whole.normal_error_deg))},
          {"sequence",
           {{"scale", evaluation.by_sequence.scale},
            {"coarse", mesh_json(evaluation.by_sequence.coarse)},
            {"finest", mesh_json(evaluation.by_sequence.refined)}}},
          {"neutral", neutral_json(evaluation)},
          {"bands", bands_json(evaluation.bands)},
          {"regions", regions_json(evaluation)},
          {"expressions", expressions_json(evaluation.weights)},
          {"pose", pose_json(evaluation.pose)},
          {"left_out", evaluation.left_out}};
}

/// "0.684 mm" or why there is none.
std::string text_of(double value, const char* unit) {
  return std::isfinite(value) ? fmt::format("{:.3g} {}", value, unit) : "not known";
}

void tell_headline(const std::string& take, const report::TakeEvaluation& evaluation,
                   const std::filesystem::path& picture) {
  const report::MeshFigures& coarse = evaluation.by_frame.coarse;
  const report::MeshFigures& refined = evaluation.by_frame.refined;
  for (const auto& [what, why] : evaluation.left_out) {
    tell(stderr, "facet: no {}: {}\n", what, why);
  }
  tell(stderr, "heat map in {}\n", picture.string());
  tell(stderr,
       "{}: {} frames; refined (coarse): to the surface {:.3f} mm ({:.3f}), to the same skin point {} ({}), "
       "drift {} ({}), normals {:.2f} deg ({:.2f}), wrinkles correlate by {}\n",
       take, evaluation.frames.size(), refined.whole.mean_mm, coarse.whole.mean_mm,
       text_of(refined.skin.mean_mm, "mm"), text_of(coarse.skin.mean_mm, "mm"),
       text_of(refined.skin.drift_mm(), "mm"), text_of(coarse.skin.drift_mm(), "mm"),
       refined.whole.normal_error_deg, coarse.whole.normal_error_deg,
       text_of(evaluation.bands.back().correlation(), ""));
}

void run_eval(const EvalOptions& options) {
  take::TakeReader take(options.take);
  std::optional<Progress> progress;
  report::EvaluationOptions how{.alignment = alignment_of(options.align),
                                .mm_per_unit = mm_per_unit(options.unit),
                                .frames = {},
                                .model = options.model};
  if (!options.frames.empty()) {
    how.frames = frames_in_range(take, options.frames);
  }
  const report::TakeEvaluation evaluation =
      report::evaluate_take(take, options.truth, how, [&](std::uint64_t done, std::uint64_t total) {
        if (!progress) {
          progress.emplace("Measuring", total);
        }
        progress->set(done);
      });
  progress.reset();
  const ordered_json document = document_of(options, evaluation);
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
  tell_headline(options.take, evaluation, picture);
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
  command.option(
      "--model", options->model,
      "The face model that the take was made with, for the parts of the face and the face at rest");
  command.option("-o,--output", options->output, "JSON to write; default: standard output");
  command.option("--heat-map", options->heat_map, "PNG to write; default: TAKE with .eval.png");
  command.callback([options] { run_eval(*options); });
}

}  // namespace facet::tools
