// What a frame's budget buys: the energy that the displacement solve ends with [MD19 eq. 6] and
// the time it takes, over sequences of facet synth, against the paper's ten Gauss-Newton steps on every
// level.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "face/face_parts.hpp"
#include "facet/error.hpp"
#include "truth_sequence.hpp"

namespace {

using facet::Error;
using facet::ErrorKind;
using facet::bench::Sequence;
using facet::refine::RefinerConfig;

struct Run {
  std::string name;
  std::vector<std::vector<double>> energies;  ///< [frame][level] after the last step
  double displacement_ms = 0;                 ///< mean
  double worst_ms = 0;
};

/// Every frame with the albedo held, so that all budgets minimise the same energy.
Run run(facet::gpu::Context& context, const facet::face::FaceModel& model, const Sequence& sequence,
        const std::shared_ptr<const facet::mesh::Albedo>& albedo, const std::string& name,
        RefinerConfig config) {
  config.record_energies = true;
  facet::refine::Refiner refiner(context, config);
  refiner.set_subject({sequence.subject->hierarchy, model.mean_albedo, model.control.refinable, albedo,
                       facet::face::shading_trust(model), model.identity_count() == 0});
  Run out;
  out.name = name;
  facet::refine::RefineOutput output;
  for (const facet::bench::TrackedFrame& frame : sequence.frames) {
    refiner.submit({frame.image, frame.camera, frame.camera_from_head, &frame.control_vertices_mm});
    if (refiner.collect(output) != facet::refine::RefineOutcome::Refined) {
      throw Error(ErrorKind::Internal, output.failure);
    }
    std::vector<double>& last = out.energies.emplace_back();
    for (const auto& level : output.energies) {
      last.push_back(level.back());
    }
    out.displacement_ms += static_cast<double>(output.displacement_ms);
    out.worst_ms = std::max(out.worst_ms, static_cast<double>(output.displacement_ms));
  }
  out.displacement_ms /= static_cast<double>(sequence.frames.size());
  return out;
}

/// Mean and worst ratio of the finest level's energy to the paper budget's, of all frames but the first.
void report(const Run& run, const Run& paper) {
  const std::size_t levels = paper.energies.front().size();
  std::vector<double> mean(levels, 0);
  double worst = 0;
  for (std::size_t k = 1; k < run.energies.size(); ++k) {
    for (std::size_t l = 0; l < levels; ++l) {
      mean[l] += run.energies[k][l] / paper.energies[k][l] / static_cast<double>(run.energies.size() - 1);
    }
    worst = std::max(worst, run.energies[k].back() / paper.energies[k].back());
  }
  fmt::print("| {} | {:.1f} | {:.3f} | {:+.2f} % | {:+.2f} % |", run.name, run.displacement_ms,
             run.displacement_ms / paper.displacement_ms, 100 * (mean.back() - 1), 100 * (worst - 1));
  for (const double ratio : mean) {
    fmt::print(" {:+.2f}", 100 * (ratio - 1));
  }
  fmt::print(" |\n");
}

/// Mean energy that the finest level ends with, of all frames but the first.
double final_energy(const Run& run) {
  double sum = 0;
  for (std::size_t k = 1; k < run.energies.size(); ++k) {
    sum += run.energies[k].back();
  }
  return sum / static_cast<double>(std::max<std::size_t>(run.energies.size(), 2) - 1);
}

/// Energies by "sequence/budget" that another device ended with: lines of a name and a number.
class Reference {
 public:
  explicit Reference(const std::filesystem::path& file) {
    std::ifstream stream(file);
    std::string name;
    for (double energy = 0; stream >> name >> energy;) {
      energies_[name] = energy;
    }
    if (energies_.empty() || !stream.eof()) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("{} is no file of energies: make one on another device with --write-reference",
                              file.string()));
    }
  }

  /// Says how far off the energy is; false where it is more than a percent, or the reference has none.
  bool is_near(const std::string& name, double energy) const {
    constexpr double kTolerance = 0.01;
    const auto found = energies_.find(name);
    if (found == energies_.end()) {
      fmt::print("{}: the reference has no such sequence and budget\n", name);
      return false;
    }
    const double off = energy / found->second - 1;
    fmt::print("{}: energy {:+.3f} % from the reference{}\n", name, 100 * off,
               std::abs(off) <= kTolerance ? "" : ", MORE THAN A PERCENT");
    return std::abs(off) <= kTolerance;
  }

 private:
  std::map<std::string, double> energies_;
};

}  // namespace

int main(int argc, char** argv) {
  std::vector<std::filesystem::path> folders;
  facet::bench::SequenceOptions options;
  options.measure_every = 1'000'000;
  std::string device = "auto";
  std::vector<std::string> budgets{"auto", "fixed"};
  std::filesystem::path reference_file;
  std::filesystem::path written_file;
  CLI::App app("Energy and time of the displacement solve by its budget, on sequences of facet synth");
  app.add_option("folders", folders, "Folders that facet synth wrote")->required();
  app.add_option("--min-edge-px", options.min_edge_px, "Of the hierarchy")->capture_default_str();
  app.add_option("--model", options.model, "Face model file")->capture_default_str();
  app.add_option("--device", device, "GPU, by part of its name")->capture_default_str();
  app.add_option("--budgets", budgets,
                 "Beside the paper's: auto, fixed (one to three steps of 3 and 7 iterations)")
      ->allow_extra_args(false)
      ->delimiter(',')
      ->check(CLI::IsMember({"auto", "fixed"}))
      ->capture_default_str();
  app.add_option("--reference", reference_file,
                 "Compare energies with those in this file: exit 1 where one is off by more than a percent");
  app.add_option("--write-reference", written_file, "Leave the energies in this file, for other devices");
  CLI11_PARSE(app, argc, argv);
  bool met = true;
  try {
    const auto model = facet::face::FaceModel::load(options.model);
    facet::gpu::ContextOptions context_options;
    context_options.device = device;
    facet::gpu::Context context(context_options);
    std::optional<Reference> reference;
    if (!reference_file.empty()) {
      reference.emplace(reference_file);
    }
    std::ofstream written;
    if (!written_file.empty()) {
      written.open(written_file);
    }
    for (const auto& folder : folders) {
      const Sequence sequence = facet::bench::load_sequence(model, options, folder);
      std::shared_ptr<const facet::mesh::Albedo> albedo;
      facet::bench::refine_sequence(
          context, model, sequence, RefinerConfig(),
          [&](std::size_t, const facet::refine::RefineOutput& output) { albedo = output.albedo; });
      fmt::print(
          "\n{}: {} frames, {} levels, {} vertices\n\n| budget | ms a frame | of paper's | energy, mean | "
          "worst "
          "frame | by level, % |\n|---|---|---|---|---|---|\n",
          sequence.name, sequence.frames.size(), sequence.subject->hierarchy->levels.size(),
          sequence.subject->hierarchy->finest().vertex_count);
      RefinerConfig config;
      config.budget = facet::refine::Budget::Paper;
      const Run paper = run(context, model, sequence, albedo, "paper", config);
      const auto show = [&](const Run& one) {
        report(one, paper);
        const std::string name = sequence.name + "/" + one.name;
        if (one.name == "paper" || one.name == "auto") {
          const double energy = final_energy(one);
          written << name << ' ' << fmt::format("{:.9g}", energy) << '\n';
          met = (!reference || reference->is_near(name, energy)) && met;
        }
      };
      show(paper);
      if (std::ranges::count(budgets, "auto") > 0) {
        config.budget = facet::refine::Budget::Auto;
        show(run(context, model, sequence, albedo, "auto", config));
      }
      if (std::ranges::count(budgets, "fixed") == 0) {
        continue;
      }
      config.budget = facet::refine::Budget::Fixed;
      for (const int steps : {1, 2, 3}) {
        for (const int pcg : {3, 7}) {
          config.gauss_newton_steps = steps;
          config.pcg_iterations = pcg;
          show(run(context, model, sequence, albedo, fmt::format("{} steps of {}", steps, pcg), config));
        }
      }
    }
    if (!written_file.empty() && !written.flush()) {
      throw Error(ErrorKind::Storage, fmt::format("cannot write {}", written_file.string()));
    }
  } catch (const Error& error) {
    fmt::print(stderr, "budget_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return met ? 0 : 1;
}
