// Depth maps of footage whose depth is known: error, fill, ridges and time of global and local spacetime
// stereo, of window matching frame by frame and of OpenCV's StereoSGBM on the same pictures in the same run.
// Prints markdown.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "facet/error.hpp"
#include "gpu/context.hpp"
#include "render/renderer.hpp"
#include "stereo/stereo_matcher.hpp"
#include "stereo_footage.hpp"
#include "stereo_metrics.hpp"
#include "stereo_others.hpp"
#include "stereo_vector.hpp"

namespace {

using facet::bench::DepthFigures;
using facet::bench::StereoFootage;

struct Options {
  std::vector<std::string> scenes{"actor", "wave", "step", "booth-plane", "booth-sphere"};
  std::filesystem::path model = std::filesystem::path(FACET_ASSETS_FOLDER) / "default.facemodel";
  std::size_t pair = 0;
  std::vector<std::string> methods{"global", "local", "frame", "windows", "sgbm"};
  facet::bench::SceneOptions scene;
  std::string device = "auto";
  std::filesystem::path pictures;
  std::string start = "sgm";
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  facet::stereo::StereoOptions stereo;
};

void show_times(const facet::stereo::StereoTimes& times, std::size_t slots) {
  const auto count = static_cast<float>(slots);
  fmt::print("  per depth map, ms: rectify {:.0f}, start {:.0f}, solve {:.0f}, finish {:.0f}\n",
             times.rectify_ms / count, times.start_ms / count, times.solve_ms / count,
             times.finish_ms / count);
}

std::vector<std::vector<float>> spacetime(facet::gpu::Context& context, const StereoFootage& footage,
                                          const Options& options, facet::stereo::StereoOptions stereo,
                                          const std::string& method) {
  using facet::stereo::SpacetimeMethod;
  stereo.most_slots = static_cast<int>(footage.slots.size());
  stereo.depths = footage.depths;
  stereo.start.method =
      options.start == "sgm" ? facet::stereo::StartMethod::SemiGlobal : facet::stereo::StartMethod::ScanLines;
  stereo.spacetime.method =
      method == "local" || method == "direct" ? SpacetimeMethod::Local : SpacetimeMethod::Global;
  if (method == "frame") {
    stereo.spacetime.window_t = 1;
    stereo.start.window_t = 1;
  }
  facet::stereo::StereoMatcher matcher(context, footage.rig, footage.pair, stereo);
  std::vector<facet::capture::DepthMap> maps;
  if (matcher.match(footage.slots, maps) != facet::stereo::SolveOutcome::Done) {
    throw facet::Error(facet::ErrorKind::Internal, matcher.failure());
  }
  fmt::print("\n{} {}:", footage.name, method);
  for (const double energy : matcher.field().energies) {
    fmt::print(" {:.5g}", energy);
  }
  fmt::print("\n");
  show_times(matcher.times(), maps.size());
  std::vector<std::vector<float>> out;
  if (method == "start") {
    const std::size_t count = maps.front().depth_mm.size();
    for (std::size_t slot = 0; slot < maps.size(); ++slot) {
      std::vector<float> depth(count, 0.0F);
      for (std::size_t at = 0; at < count; ++at) {
        const float d = matcher.start_px()[slot * count + at];
        depth[at] =
            std::isnan(d) ? 0 : static_cast<float>(matcher.rectification().depth_mm(static_cast<double>(d)));
      }
      out.push_back(std::move(depth));
    }
    return out;
  }
  if (method == "vector") {
    const facet::bench::VectorStereoResult result = facet::bench::solve_on_vectors(
        {footage.width_px, footage.height_px, stereo.most_slots}, matcher.left_grey(), matcher.right_grey(),
        matcher.start_px(), stereo.spacetime, options.threads);
    const std::vector<float>& product = matcher.field().disparity_px;
    std::vector<float> differences;
    for (std::size_t at = 0; at < product.size(); ++at) {
      if (matcher.field().sigma_px[at] > 0) {
        differences.push_back(std::abs(product[at] - result.disparity_px[at]));
      }
    }
    std::sort(differences.begin(), differences.end());
    float device_ms = 0;
    for (const auto& stage : matcher.stage_times()) {
      device_ms += stage.name == "solve" ? stage.ms : 0;
    }
    const auto slots = static_cast<double>(maps.size());
    fmt::print(
        "  one Gauss-Newton step of one slot, ms: product {:.1f}, vector units {:.1f} (windows {:.1f}, CG "
        "{:.1f}), ratio {:.2f}; fields "
        "differ by {:.5f} px (median), {:.4f} px (99 %)\n",
        static_cast<double>(device_ms) / stereo.spacetime.steps / slots,
        (result.windows_ms + result.solve_ms) / slots, result.windows_ms / slots, result.solve_ms / slots,
        static_cast<double>(device_ms) / stereo.spacetime.steps / (result.windows_ms + result.solve_ms),
        differences[differences.size() / 2], differences[differences.size() * 99 / 100]);
  }
  if (method == "direct") {
    // Where the product's local method has a depth, so that the two are compared on the same pixels.
    out = facet::bench::match_local_direct(footage, matcher, stereo.spacetime);
    for (std::size_t slot = 0; slot < out.size(); ++slot) {
      for (std::size_t at = 0; at < out[slot].size(); ++at) {
        out[slot][at] = maps[slot].depth_mm[at] > 0 ? out[slot][at] : 0;
      }
    }
    return out;
  }
  double square = 0;
  double n = 0;
  for (std::size_t slot = 0; slot < maps.size(); ++slot) {
    const auto& map = maps[slot];
    for (std::size_t at = 0; at < map.depth_mm.size(); ++at) {
      const double truth = static_cast<double>(footage.truth_mm[slot][at]);
      if (map.depth_mm[at] > 0 && truth > 0) {
        const double error = static_cast<double>(map.depth_mm[at]) - truth;
        if (std::abs(error) < 2) {
          square += error * error / static_cast<double>(map.sigma_mm[at] * map.sigma_mm[at]);
          n += 1;
        }
      }
    }
    out.push_back(map.depth_mm);
  }
  fmt::print("  error / sigma, rms: {:.2f}\n", std::sqrt(square / n));
  return out;
}

void run(const Options& options) {
  facet::gpu::ContextOptions context_options;
  context_options.device = options.device;
  facet::gpu::Context context(context_options);
  std::string table =
      "| scene | method | slots | median mm | 95 % mm | fill % | invented px | ridges rms mm "
      "|\n|---|---|---|---|---|---|---|---|\n";
  std::optional<facet::face::FaceModel> model;
  for (const std::string& scene : options.scenes) {
    const bool in_booth = scene == "actor" || scene.rfind("booth-", 0) == 0;
    if (in_booth && !model) {
      model = facet::face::FaceModel::load(options.model);
    }
    const StereoFootage footage =
        in_booth ? facet::bench::booth_footage(*model, scene, options.pair, options.scene)
                 : facet::bench::scene_footage(scene, options.scene);
    for (const std::string& method : options.methods) {
      std::vector<std::vector<float>> maps;
      if (method == "windows") {
        maps = facet::bench::match_windows(footage);
      } else if (method == "sgbm") {
        maps = facet::bench::match_sgbm(footage);
      } else {
        maps = spacetime(context, footage, options, options.stereo, method);
      }
      for (const bool blank : {false, true}) {
        DepthFigures figures;
        for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
          if (footage.slots[slot].has_pattern != blank && !maps[slot].empty()) {
            figures.add(footage, slot, maps[slot]);
          }
        }
        if (figures.empty()) {
          continue;
        }
        table +=
            fmt::format("| {} | {} | {} | {:.3f} | {:.3f} | {:.1f} | {} | {:.4f} |\n", scene, method,
                        blank ? "blank" : "pattern", figures.percentile_mm(0.5), figures.percentile_mm(0.95),
                        100 * figures.fill(), figures.invented(), figures.ridges_mm());
      }
      if (!options.pictures.empty()) {
        std::filesystem::create_directories(options.pictures);
        for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
          if (!maps[slot].empty()) {
            facet::render::write_png(facet::bench::relief(footage, maps[slot]),
                                     options.pictures / fmt::format("{}-{}-{}.png", scene, method, slot));
            facet::render::write_png(
                facet::bench::error_picture(footage, slot, maps[slot]),
                options.pictures / fmt::format("{}-{}-{}-error.png", scene, method, slot));
          }
        }
      }
    }
  }
  fmt::print("\n{}", table);
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("Depth maps of footage whose depth is known: error, fill, ridges and time");
  app.add_option("--scenes", options.scenes, "actor, booth-plane, booth-sphere; plane, sphere, wave, step")
      ->delimiter(',');
  app.add_option("--methods", options.methods,
                 "global, local, direct, frame, start, windows, sgbm, vector (global, and its time beside "
                 "hand-written C++)")
      ->delimiter(',');
  app.add_option("--model", options.model, "face model of the actor");
  app.add_option("--pair", options.pair, "of the booth: 0 or 1");
  app.add_option("--first-slot", options.scene.first_slot, "of the booth's performance");
  app.add_option("--width", options.scene.width_px);
  app.add_option("--height", options.scene.height_px);
  app.add_option("--slots", options.scene.slots);
  app.add_option("--seed", options.scene.seed);
  app.add_option("--speed", options.scene.speed_mm_per_slot, "mm per slot, of the wave");
  app.add_option("--stripe", options.scene.stripe_mm, "width of a stripe, mm");
  app.add_option("--grey-noise", options.scene.noise, "of the pictures, linear grey at full light");
  app.add_option("--device", options.device);
  app.add_option("--start", options.start, "sgm or lines");
  app.add_option("--paths", options.stereo.start.path_count);
  app.add_option("--start-slots", options.stereo.start.window_t);
  app.add_option("--step-cost", options.stereo.start.step_cost);
  app.add_option("--jump-cost", options.stereo.start.jump_cost);
  app.add_option("--most-cost", options.stereo.start.most_cost);
  app.add_option("--uniqueness", options.stereo.start.uniqueness);
  app.add_option("--break", options.stereo.spacetime.break_px);
  app.add_option("--damping", options.stereo.spacetime.damping);
  app.add_option("--correlation", options.stereo.least_correlation);
  app.add_option("--sigma", options.stereo.most_sigma_mm);
  app.add_option("--steps", options.stereo.spacetime.steps);
  app.add_option("--iterations", options.stereo.spacetime.cg_iterations);
  app.add_option("--block-x", options.stereo.spacetime.block_x);
  app.add_option("--block-y", options.stereo.spacetime.block_y);
  app.add_option("--block-t", options.stereo.spacetime.block_t);
  app.add_option("--window-x", options.stereo.spacetime.window_x);
  app.add_option("--window-y", options.stereo.spacetime.window_y);
  app.add_option("--window-t", options.stereo.spacetime.window_t);
  app.add_option("--straddle", options.stereo.spacetime.straddle_px);
  app.add_option("--noise", options.stereo.spacetime.noise);
  app.add_option("--pictures", options.pictures, "folder for shaded reliefs");
  CLI11_PARSE(app, argc, argv);
  try {
    run(options);
  } catch (const facet::Error& error) {
    fmt::print(stderr, "{}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return 0;
}
