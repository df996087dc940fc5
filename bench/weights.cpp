// Chooses the weights of the refinement's energies: runs the product's tracker and refiner over sequences
// with known geometry (`facet synth`), once per value of one setting, and prints how near the truth each
// comes.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "truth_sequence.hpp"

namespace {

using facet::Error;
using facet::ErrorKind;
using facet::bench::MeasuredFrame;
using facet::bench::Score;
using facet::bench::Sequence;
using facet::bench::TrackedFrame;
using facet::refine::RefinerConfig;

struct Options : facet::bench::SequenceOptions {
  std::vector<std::filesystem::path> folders;
  std::vector<std::string> base;    ///< NAME=VALUE
  std::vector<std::string> sweeps;  ///< NAME=VALUE,VALUE,...
  std::string device = "auto";
  bool reach = false;
  bool coarse_alone = false;
  bool without_skin = false;
  bool without_skin_albedo = false;
};

/// A setting of the refiner by name.
void set(RefinerConfig& config, const std::string& name, float value) {
  if (name == "w1") {
    config.weights.lighting_temporal = value;
  } else if (name == "w2") {
    config.weights.albedo_smooth = value;
  } else if (name == "w3") {
    config.weights.displacement_smooth = value;
  } else if (name == "w3_known") {
    config.weights.displacement_smooth_known = value;
  } else if (name == "w4") {
    config.weights.displacement_hierarchy = value;
  } else if (name == "w2_known") {
    config.weights.albedo_smooth_known = value;
  } else if (name == "w5") {
    config.weights.displacement_coarse = value;
  } else if (name == "w5_known") {
    config.weights.displacement_coarse_known = value;
  } else if (name == "fold") {
    config.fold_slope = value;
  } else if (name == "robust") {
    config.robust_scale = value;
  } else if (name == "metric") {
    config.metric_floor = value;
  } else if (name == "steps") {
    config.budget = facet::refine::Budget::Fixed;
    config.gauss_newton_steps = static_cast<int>(value);
  } else if (name == "pcg") {
    config.budget = facet::refine::Budget::Fixed;
    config.pcg_iterations = static_cast<int>(value);
  } else if (name == "albedo_frames") {
    config.albedo_frames = static_cast<int>(value);
  } else if (name == "fine_albedo") {
    config.fine_albedo = value != 0;
  } else if (name == "room_lamps") {
    config.room_lamps = value != 0 ? facet::refine::RoomLamps::Always : facet::refine::RoomLamps::Never;
  } else if (name == "hierarchical") {
    config.hierarchical = value != 0;
  } else if (name == "paper") {
    config.budget = value != 0 ? facet::refine::Budget::Paper : facet::refine::Budget::Auto;
  } else {
    throw Error(
        ErrorKind::Usage,
        fmt::format(
            "no setting {}; there are w1 to w5, w2_known, w3_known, w5_known, fold, robust, metric, steps, "
            "pcg, albedo_frames, fine_albedo, room_lamps, hierarchical, paper",
            name));
  }
}

struct Setting {
  std::string name;
  std::vector<float> values;
};

Setting parse_setting(const std::string& text) {
  const std::size_t equals = text.find('=');
  if (equals == std::string::npos) {
    throw Error(ErrorKind::Usage, fmt::format("{}: write a setting as NAME=VALUE or NAME=VALUE,VALUE", text));
  }
  Setting out{text.substr(0, equals), {}};
  std::size_t at = equals + 1;
  while (at <= text.size()) {
    const std::size_t comma = std::min(text.find(',', at), text.size());
    out.values.push_back(std::stof(text.substr(at, comma - at)));
    at = comma + 1;
  }
  return out;
}

/// One row of the table: the setting's name, then change against the coarse mesh for every sequence.
void try_setting(facet::gpu::Context& context, const facet::face::FaceModel& model,
                 const std::vector<Sequence>& sequences, const RefinerConfig& config,
                 const std::string& name) {
  fmt::print("{:<22}", name);
  Score total;
  double normal_change = 0;
  double distance_change = 0;
  for (const Sequence& sequence : sequences) {
    const Score score = facet::bench::refine_sequence(context, model, sequence, config);
    const double normal = 100 * (score.normal_deg / sequence.coarse.normal_error_deg - 1);
    const double distance = 100 * (score.mean_mm / sequence.coarse.mean_mm - 1);
    fmt::print(" {:6.2f} {:+6.1f}% {:+6.1f}% {:.3f}/{:.2f}", score.normal_deg, normal, distance,
               score.wrinkle_correlation, score.wrinkle_depth);
    const double share = 1 / static_cast<double>(sequences.size());
    normal_change += share * normal;
    distance_change += share * distance;
    total.wrinkle_correlation += share * score.wrinkle_correlation;
    total.photometric_rms += share * score.photometric_rms;
    total.trembling_mm += share * score.trembling_mm;
    total.device_ms += share * score.device_ms;
  }
  fmt::print(" | {:+6.1f}% {:+6.1f}%  {:.3f}  {:.4f}  {:.4f}  {:6.1f}\n", normal_change, distance_change,
             total.wrinkle_correlation, total.photometric_rms, total.trembling_mm, total.device_ms);
  std::fflush(stdout);
}

/// Displacements that reach the truth along the coarse normals, each smoothed over its ring `rounds` times.
std::vector<float> true_displacements(const Sequence& sequence, const MeasuredFrame& measured, int rounds) {
  std::vector<float> displacements_mm = measured.true_displacements_mm;
  for (float& value : displacements_mm) {
    value = std::isnan(value) ? 0 : value;
  }
  const facet::mesh::OneRings& rings = sequence.subject->hierarchy->finest().one_rings;
  for (int round = 0; round < rounds; ++round) {
    std::vector<float> smoother = displacements_mm;
    for (std::size_t v = 0; v < smoother.size(); ++v) {
      const auto first = static_cast<std::size_t>(rings.offsets[v]);
      const auto end = static_cast<std::size_t>(rings.offsets[v + 1]);
      float sum = 0;
      for (std::size_t k = first; k < end; ++k) {
        sum += displacements_mm[static_cast<std::size_t>(rings.neighbours[k])];
      }
      smoother[v] = 0.5F * displacements_mm[v] + 0.5F * sum / static_cast<float>(end - first);
    }
    displacements_mm = std::move(smoother);
  }
  return displacements_mm;
}

/// What displacements along the normals could reach, and at which width of smoothing it is lost.
void print_reach(const std::vector<Sequence>& sequences) {
  for (const int rounds : {0, 10, 40, 160, 640}) {
    fmt::print("reach, smoothed {:<6}", rounds);
    for (const Sequence& sequence : sequences) {
      facet::report::FigureSum sum;
      for (const auto& [k, measured] : sequence.measured) {
        const TrackedFrame& frame = sequence.frames[k];
        const auto mesh =
            facet::bench::reconstruct(sequence, frame, true_displacements(sequence, measured, rounds));
        sum.add(static_cast<std::int64_t>(k), measured.vertices,
                facet::bench::compare_aligned(mesh, measured), 0);
      }
      const facet::report::AccuracyFigures figures = sum.figures();
      fmt::print(" {:6.2f} {:+6.1f}% {:+6.1f}%", figures.normal_error_deg,
                 100 * (figures.normal_error_deg / sequence.coarse.normal_error_deg - 1),
                 100 * (figures.mean_mm / sequence.coarse.mean_mm - 1));
    }
    fmt::print("\n");
  }
}

void run(const Options& options) {
  RefinerConfig base;
  for (const std::string& text : options.base) {
    const Setting setting = parse_setting(text);
    set(base, setting.name, setting.values.front());
  }
  std::vector<Setting> sweeps;
  for (const std::string& text : options.sweeps) {
    sweeps.push_back(parse_setting(text));
    RefinerConfig probe;
    set(probe, sweeps.back().name, sweeps.back().values.front());
  }
  facet::face::FaceModel model = facet::face::FaceModel::load(options.model);
  if (options.without_skin) {
    model.skin = {};
  }
  if (options.without_skin_albedo) {
    model.skin.albedo.clear();
  }
  if (options.coarse_alone) {
    for (const std::filesystem::path& folder : options.folders) {
      facet::bench::load_sequence(model, options, folder);
    }
    return;
  }
  facet::gpu::ContextOptions context_options;
  context_options.device = options.device;
  facet::gpu::Context context(context_options);
  std::vector<Sequence> sequences;
  for (const std::filesystem::path& folder : options.folders) {
    sequences.push_back(facet::bench::load_sequence(model, options, folder));
  }
  fmt::print(
      "\nPer sequence: normal error in degrees, its change and the mean distance's change against the coarse "
      "mesh, correlation and depth of the wrinkles (tools::WrinkleSum).\nThen: both changes and the "
      "correlation averaged, photometric rms, rms change of displacements per frame (mm), "
      "device "
      "ms per frame.\n\n");
  if (options.reach) {
    print_reach(sequences);
  }
  try_setting(context, model, sequences, base, "base");
  for (const Setting& sweep : sweeps) {
    for (const float value : sweep.values) {
      RefinerConfig config = base;
      set(config, sweep.name, value);
      try_setting(context, model, sequences, config, fmt::format("{} = {}", sweep.name, value));
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("Sweeps the refinement's settings over synthetic sequences with truth");
  app.add_option("folders", options.folders, "Folders that facet synth wrote")->required();
  app.add_option("--base", options.base, "Settings that all rows share, NAME=VALUE");
  app.add_option("--sweep", options.sweeps, "A setting and the values to try, NAME=VALUE,VALUE,...");
  app.add_option("--measure-every", options.measure_every, "Frames from one measured frame to the next")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--coarse", options.coarse,
                 "Coarse meshes of the tracker, or of the truth inside the model's span")
      ->check(CLI::IsMember({"tracker", "truth"}))
      ->capture_default_str();
  app.add_option("--albedo", options.albedo,
                 "Learned, or the truth's: what the rest of the method makes of it")
      ->check(CLI::IsMember({"learned", "truth"}))
      ->capture_default_str();
  app.add_option("--min-edge-px", options.min_edge_px, "Of the hierarchy")->capture_default_str();
  app.add_flag(
      "--reach", options.reach,
      "First what displacements could reach at best: the truth's own along the coarse normals, whole and "
      "smoothed");
  app.add_flag("--without-skin", options.without_skin, "Leave out what a person's model knows of the skin");
  app.add_flag("--without-skin-albedo", options.without_skin_albedo, "Of it leave out the albedo");
  app.add_flag("!--without-following", options.follow_skin, "Leave the mesh where the tracker has it");
  app.add_flag("--coarse-alone", options.coarse_alone, "Measure the coarse meshes and refine nothing");
  app.add_option("--model", options.model, "Face model file")->capture_default_str();
  app.add_option("--device", options.device, "GPU, by part of its name")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    run(options);
  } catch (const Error& error) {
    fmt::print(stderr, "weights: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return 0;
}
