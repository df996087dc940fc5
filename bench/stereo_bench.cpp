// Depth maps of footage whose depth is known: error, fill, ridges and time of global and local spacetime
// stereo, of window matching frame by frame and of OpenCV's StereoSGBM on the same pictures in the same run.
// Prints markdown.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <numbers>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "facet/assets.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "gpu/context.hpp"
#include "render/renderer.hpp"
#include "scan/structured_light.hpp"
#include "simulation/virtual_booth.hpp"
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
  std::filesystem::path model = facet::default_model_file();
  std::size_t pair = 0;
  std::vector<std::string> methods{"global", "local", "frame", "windows", "sgbm"};
  facet::bench::SceneOptions scene;
  std::string device = "auto";
  std::filesystem::path pictures;
  std::string start = "sgm";
  std::string start_on = "best";
  int repeat = 1;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  facet::stereo::StereoOptions stereo;
  std::string sequence = "phase:8x64,gray:6,gray-inverse:6";
  std::string program = "stripes";
  facet::scan::DecodeOptions decode;
  facet::scan::StructuredLightOptions structured;
};

void show_times(const facet::stereo::StereoTimes& times, std::size_t slots) {
  const auto count = static_cast<float>(slots);
  fmt::print("  per depth map, ms: rectify {:.0f}, start {:.0f}, solve {:.0f}, finish {:.0f}\n",
             times.rectify_ms / count, times.start_ms / count, times.solve_ms / count,
             times.finish_ms / count);
}

/// Why skin that both cameras see has no depth, over the judged pattern slots; drawn where a folder is given:
/// unlit blue, no start value red, correlation yellow, sigma green, dropped (behind, islands) white.
void explain_holes(const StereoFootage& footage, const Options& options,
                   const facet::stereo::StereoOptions& stereo, const facet::stereo::StereoMatcher& matcher,
                   const std::vector<facet::capture::DepthMap>& maps) {
  constexpr std::array kReasons = {"not lit", "no start value", "correlation", "sigma", "dropped"};
  constexpr std::array<std::array<std::uint8_t, 3>, 5> kColours = {
      {{60, 90, 255}, {255, 60, 60}, {255, 230, 0}, {0, 200, 60}, {255, 255, 255}}};
  std::array<std::size_t, 5> counts{};
  std::size_t seen = 0;
  const std::size_t count = maps.front().depth_mm.size();
  for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
    if (!footage.slots[slot].has_pattern) {
      continue;
    }
    facet::render::Picture picture =
        facet::render::plain_picture(footage.width_px, footage.height_px, {90, 90, 90});
    for (std::size_t at = 0; at < count; ++at) {
      if (!footage.seen[slot][at]) {
        continue;
      }
      ++seen;
      std::array<std::uint8_t, 3> colour{0, 0, 0};
      if (!(maps[slot].depth_mm[at] > 0)) {
        const std::size_t voxel = slot * count + at;
        bool lit = false;
        for (std::size_t near = slot >= 2 ? slot - 2 : 0; near < std::min(slot + 3, footage.slots.size());
             ++near) {
          lit = lit || matcher.left_grey()[near * count + at] >= stereo.start.least_grey;
        }
        const double depth =
            matcher.rectification().depth_mm(static_cast<double>(matcher.field().disparity_px[voxel]));
        const float sigma_mm = matcher.field().sigma_px[voxel] *
                               static_cast<float>(matcher.rectification().depth_per_px_mm(depth));
        const std::size_t reason = !lit                                                            ? 0
                                   : std::isnan(matcher.start_px()[voxel])                         ? 1
                                   : matcher.field().correlation[voxel] < stereo.least_correlation ? 2
                                   : !(sigma_mm > 0 && sigma_mm <= stereo.most_sigma_mm)           ? 3
                                                                                                   : 4;
        ++counts.at(reason);
        colour = kColours.at(reason);
      }
      std::copy(colour.begin(), colour.end(), picture.rgb.begin() + static_cast<std::ptrdiff_t>(3 * at));
    }
    if (!options.pictures.empty()) {
      std::filesystem::create_directories(options.pictures);
      facet::render::write_png(picture,
                               options.pictures / fmt::format("{}-holes-{}.png", footage.name, slot));
    }
  }
  fmt::print("  holes in what both cameras see, %:");
  for (std::size_t reason = 0; reason < kReasons.size(); ++reason) {
    fmt::print(" {} {:.2f}{}", kReasons.at(reason),
               100 * static_cast<double>(counts.at(reason)) / static_cast<double>(seen),
               reason + 1 < kReasons.size() ? "," : "\n");
  }
}

double cpu_ms() {
  return 1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

/// CPU time of one Gauss-Newton step on a software device: what more steps take more. CPU time, since the
/// clock on the wall says more about what else runs on the machine.
double product_step_ms(facet::gpu::Context& context, const facet::stereo::VolumeSize& size,
                       const facet::stereo::StereoMatcher& matcher, facet::stereo::SpacetimeOptions options) {
  constexpr int kMore = 4;
  std::array<double, 2> times{};
  for (const int more : {0, kMore}) {
    options.steps = 1 + more;
    facet::stereo::SpacetimeSolver solver(context, size, options);
    facet::gpu::upload(context, solver.left(), std::as_bytes(matcher.left_grey()));
    facet::gpu::upload(context, solver.right(), std::as_bytes(matcher.right_grey()));
    facet::stereo::DisparityField field;
    const double begin = cpu_ms();
    solver.solve(matcher.start_px(), field);
    times.at(more == 0 ? 0 : 1) = cpu_ms() - begin;
  }
  return (times[1] - times[0]) / kMore;
}

/// How far the maps are from the truth in units of their sigma, and where they are far off.
void judge(const StereoFootage& footage, const std::vector<facet::capture::DepthMap>& maps) {
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
  }
  std::size_t wrong = 0;
  for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
    for (std::size_t at = 0; at < maps[slot].depth_mm.size(); ++at) {
      const float truth = footage.truth_mm[slot][at];
      wrong +=
          maps[slot].depth_mm[at] > 0 && truth > 0 && std::abs(maps[slot].depth_mm[at] - truth) > 2 ? 1 : 0;
    }
  }
  fmt::print(
      "  error / sigma, rms: {:.2f}; {} px of the surface, seen by both or not, are off by more than 2 mm\n",
      std::sqrt(square / n), wrong);
}

std::vector<std::vector<float>> spacetime(facet::gpu::Context& context, const StereoFootage& footage,
                                          const Options& options, facet::stereo::StereoOptions stereo,
                                          const std::string& method) {
  using facet::stereo::SpacetimeMethod;
  stereo.most_slots = static_cast<int>(footage.slots.size());
  stereo.depths = footage.depths;
  stereo.start.method =
      options.start == "sgm" ? facet::stereo::StartMethod::SemiGlobal : facet::stereo::StartMethod::ScanLines;
  stereo.start.place = options.start_on == "host"     ? facet::stereo::StartPlace::Host
                       : options.start_on == "device" ? facet::stereo::StartPlace::Device
                                                      : facet::stereo::StartPlace::Best;
  stereo.spacetime.method =
      method == "local" || method == "direct" ? SpacetimeMethod::Local : SpacetimeMethod::Global;
  if (method == "frame") {
    stereo.spacetime.window_t = 1;
    stereo.start.window_t = 1;
  }
  facet::stereo::StereoMatcher matcher(context, footage.rig, footage.pair, stereo);
  std::vector<facet::capture::DepthMap> maps;
  double wall_ms = 0;
  double processor_ms = 0;
  for (int i = 0; i < options.repeat; ++i) {
    const auto begin = facet::Clock::now();
    const double cpu_before = cpu_ms();
    if (matcher.match(footage.slots, maps) != facet::stereo::StereoOutcome::Done) {
      throw facet::Error(facet::ErrorKind::Internal, matcher.failure());
    }
    wall_ms = static_cast<double>(facet::ms_since(begin));
    processor_ms = cpu_ms() - cpu_before;
  }
  fmt::print("\n{} {}:", footage.name, method);
  for (const double energy : matcher.field().energies) {
    fmt::print(" {:.5g}", energy);
  }
  fmt::print("\n");
  show_times(matcher.times(), maps.size());
  fmt::print(
      "  {:.1f} depth maps a second, {:.0f} ms of processor time each; {} dispatches; on the device, ms:",
      1e3 * static_cast<double>(maps.size()) / wall_ms, processor_ms / static_cast<double>(maps.size()),
      matcher.dispatch_count());
  for (const facet::gpu::StageTime& stage : matcher.stage_times()) {
    fmt::print(" {} {:.2f}", stage.name, stage.ms);
  }
  fmt::print("\n");
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
    const double product_ms = product_step_ms(
        context, {footage.width_px, footage.height_px, stereo.most_slots}, matcher, stereo.spacetime);
    const auto slots = static_cast<double>(maps.size());
    fmt::print(
        "  one Gauss-Newton step of one slot, ms of CPU time: product {:.1f}, vector units {:.1f} (wall "
        "clock {:.1f}: "
        "windows {:.1f}, CG {:.1f}), ratio {:.2f}; fields differ by {:.5f} px (median), {:.4f} px (99 %)\n",
        product_ms / slots, result.cpu_ms / slots, (result.windows_ms + result.solve_ms) / slots,
        result.windows_ms / slots, result.solve_ms / slots, product_ms / result.cpu_ms,
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
  for (const facet::capture::DepthMap& map : maps) {
    out.push_back(map.depth_mm);
  }
  judge(footage, maps);
  explain_holes(footage, options, stereo, matcher, maps);
  return out;
}

/// What a method made of a scene: maps as in footage.slots, empty where it made none.
struct Result {
  const StereoFootage* footage;
  std::vector<std::vector<float>> maps;
};

class Table {
 public:
  void add(const std::string& scene, const std::string& method, const Result& result) {
    const StereoFootage& footage = *result.footage;
    for (const bool blank : {false, true}) {
      DepthFigures figures;
      for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
        if (footage.slots[slot].has_pattern != blank && !result.maps[slot].empty()) {
          figures.add(footage, slot, result.maps[slot]);
        }
      }
      if (!figures.empty()) {
        rows_ +=
            fmt::format("| {} | {} | {} | {:.3f} | {:.3f} | {:.1f} | {} | {:.4f} |\n", scene, method,
                        blank ? "blank" : "pattern", figures.percentile_mm(0.5), figures.percentile_mm(0.95),
                        100 * figures.fill(), figures.invented(), figures.ridges_mm());
      }
    }
  }
  void print() const {
    fmt::print(
        "\n| scene | method | slots | median mm | 95 % mm | fill % | invented px | ridges rms mm "
        "|\n|---|---|---|---|---|---|---|---|\n{}",
        rows_);
  }

 private:
  std::string rows_;
};

void draw(const std::filesystem::path& folder, const std::string& name, const Result& result) {
  std::filesystem::create_directories(folder);
  const StereoFootage& footage = *result.footage;
  for (std::size_t slot = footage.first_judged; slot < footage.past_judged; ++slot) {
    if (!result.maps[slot].empty()) {
      facet::render::write_png(facet::bench::relief(footage, result.maps[slot]),
                               folder / fmt::format("{}-{}.png", name, slot));
      facet::render::write_png(facet::bench::error_picture(footage, slot, result.maps[slot]),
                               folder / fmt::format("{}-{}-error.png", name, slot));
    }
  }
}

void show_view(const char* name, const facet::scan::DecodedView& view) {
  fmt::print("  {}: residual {:.3f} of the modulation", name, view.residual);
  for (std::size_t fault = 0; fault < facet::scan::kPhaseFaults; ++fault) {
    fmt::print(", {} {}", view.faults[fault],
               facet::scan::to_string(static_cast<facet::scan::PhaseFault>(fault)));
  }
  const facet::scan::PhaseField& columns = view.columns;
  fmt::print("\n    columns: {} cells a period, start {:.4f} rad, agreement {:.3f}{} {}\n",
             columns.cells_per_period, columns.start_rad, columns.agreement,
             columns.reversed ? ", reversed" : "", columns.why_no_phases);
}

/// error / sigma, rms without outliers
double relative_error(const StereoFootage& footage, const facet::capture::DepthMap& map) {
  double square = 0;
  double n = 0;
  for (std::size_t at = 0; at < map.depth_mm.size(); ++at) {
    const double error =
        static_cast<double>(map.depth_mm[at]) - static_cast<double>(footage.truth_mm.front()[at]);
    if (map.depth_mm[at] > 0 && footage.seen.front()[at] && std::abs(error) < 2) {
      square += error * error / static_cast<double>(map.sigma_mm[at] * map.sigma_mm[at]);
      n += 1;
    }
  }
  return std::sqrt(square / std::max(n, 1.0));
}

void run_structured(const facet::simulation::VirtualBooth& booth, const std::string& scene,
                    const Options& options, Table& table) {
  namespace scan = facet::scan;
  facet::bench::SceneOptions scene_options = options.scene;
  scene_options.sequence = facet::capture::parse_sequence(options.sequence);
  const facet::bench::CodedFootage coded =
      facet::bench::coded_footage(booth, scene, options.pair, scene_options, options.decode);
  fmt::print("\n{} structured light, {} pictures:\n", scene, scene_options.sequence.pictures.size());
  show_view("left", coded.left);
  show_view("right", coded.right);
  scan::StructuredLightOptions match = options.structured;
  match.depths = coded.pair.depths;
  const facet::capture::Rig& rig = booth.rig();
  const scan::StructuredDepth pair = scan::match_phases(rig, coded.pair.pair, coded.left, coded.right, match);
  const scan::StructuredDepth single =
      scan::triangulate_phases(rig, coded.left_camera, coded.projector_index, coded.left, match);
  fmt::print("  two cameras: {} ambiguous, {} disagreeing, epipolar {:.3f} px, error / sigma {:.2f}\n",
             pair.ambiguous, pair.disagreeing, pair.epipolar_px, relative_error(coded.pair, pair.map));
  fmt::print("  camera and projector: {} disagreeing, epipolar {:.3f} px, error / sigma {:.2f}\n",
             single.disagreeing, single.epipolar_px, relative_error(coded.projector, single.map));
  const Result of_pair{&coded.pair, {pair.map.depth_mm}};
  const Result of_single{&coded.projector, {single.map.depth_mm}};
  table.add(scene, "structured", of_pair);
  table.add(scene, "structured, camera and projector", of_single);
  if (!options.pictures.empty()) {
    draw(options.pictures, scene + "-structured", of_pair);
    draw(options.pictures, scene + "-structured-projector", of_single);
  }
}

/// What of the actor's skin has a depth: by the angle at which the camera that sees it flattest does, for
/// each pair and for both together. Counted are the skin's vertices; a depth within 2 mm of one is its.
void run_skin(facet::gpu::Context& context, const facet::simulation::VirtualBooth& booth,
              const Options& options) {
  namespace stereo = facet::stereo;
  constexpr std::array<double, 6> kAngles_deg = {0, 60, 70, 75, 80, 90};
  constexpr double kBelongs_mm = 2;
  struct Count {
    std::size_t seen = 0;
    std::size_t found = 0;
    void add(bool has_depth) {
      ++seen;
      found += has_depth ? 1 : 0;
    }
  };
  std::array<std::array<Count, kAngles_deg.size()>, 3> counts;  // pair 0, pair 1, both; the last: all angles
  std::vector<StereoFootage> footage;
  std::vector<std::vector<std::vector<float>>> maps;
  for (const std::size_t pair : {std::size_t{0}, std::size_t{1}}) {
    footage.push_back(facet::bench::booth_footage(booth, "actor", pair, options.scene));
    maps.push_back(spacetime(context, footage.back(), options, options.stereo, "global"));
  }
  for (std::size_t slot = footage[0].first_judged; slot < footage[0].past_judged; ++slot) {
    if (!footage[0].slots[slot].has_pattern) {
      continue;
    }
    const auto surface = booth.slot(static_cast<std::uint64_t>(options.scene.first_slot) + slot).surface();
    const facet::render::Raycaster raycaster(surface.vertices_mm, surface.triangles);
    for (Eigen::Index v = 0; v < surface.vertices_mm.cols(); ++v) {
      if (!(booth.skin()[v] > 0.5F)) {
        continue;
      }
      const Eigen::Vector3f point = surface.vertices_mm.col(v);
      double flattest_deg = 90;
      bool found_by_any = false;
      for (std::size_t pair = 0; pair < 2; ++pair) {
        const StereoFootage& of_pair = footage[pair];
        double flatter_deg = 0;
        bool seen = true;
        for (const std::size_t camera : {of_pair.pair.left, of_pair.pair.right}) {
          const facet::capture::Lens& lens = of_pair.rig.cameras[camera].lens;
          const Eigen::Vector3f centre = lens.centre_mm().cast<float>();
          const float cosine = surface.normals.col(v).dot((centre - point).normalized());
          const auto pixel = lens.project(point.cast<double>());
          seen = seen && cosine > 0 && pixel && pixel->minCoeff() >= 4 && pixel->x() < lens.width_px - 4 &&
                 pixel->y() < lens.height_px - 4 && !raycaster.occluded(point, centre, 1);
          flatter_deg = std::max(flatter_deg, std::acos(std::clamp(static_cast<double>(cosine), 0.0, 1.0)) *
                                                  180 / std::numbers::pi);
        }
        if (!seen) {
          continue;
        }
        const auto at = of_pair.lens.project(point.cast<double>());
        const Eigen::Vector2i px(at->array().round().cast<int>());
        if (px.minCoeff() < 0 || px.x() >= of_pair.width_px || px.y() >= of_pair.height_px) {
          continue;
        }
        const float depth = maps[pair][slot][static_cast<std::size_t>(px.y() * of_pair.width_px + px.x())];
        const double z = (of_pair.lens.camera_from_rig * point.cast<double>()).z();
        const bool found = depth > 0 && std::abs(static_cast<double>(depth) - z) < kBelongs_mm;
        found_by_any = found_by_any || found;
        flattest_deg = std::min(flattest_deg, flatter_deg);
        std::size_t bin = 0;
        while (bin + 2 < kAngles_deg.size() && flatter_deg >= kAngles_deg.at(bin + 1)) {
          ++bin;
        }
        counts.at(pair).at(bin).add(found);
        counts.at(pair).back().add(found);
      }
      if (flattest_deg < 90) {
        std::size_t bin = 0;
        while (bin + 2 < kAngles_deg.size() && flattest_deg >= kAngles_deg.at(bin + 1)) {
          ++bin;
        }
        counts[2].at(bin).add(found_by_any);
        counts[2].back().add(found_by_any);
      }
    }
  }
  fmt::print(
      "\n| skin that both cameras see | at less than 60 deg | 60 to 70 | 70 to 75 | 75 to 80 | above 80 | "
      "all |\n"
      "|---|---|---|---|---|---|---|\n");
  constexpr std::array kNames = {"left pair", "right pair", "either pair"};
  for (std::size_t row = 0; row < counts.size(); ++row) {
    fmt::print("| {}: fill % (share of its skin %) |", kNames.at(row));
    for (const Count& count : counts.at(row)) {
      const auto seen = static_cast<double>(std::max<std::size_t>(count.seen, 1));
      fmt::print(" {:.1f} ({:.1f}) |", 100 * static_cast<double>(count.found) / seen,
                 100 * static_cast<double>(count.seen) /
                     static_cast<double>(std::max<std::size_t>(counts.at(row).back().seen, 1)));
    }
    fmt::print("\n");
  }
}

void run(const Options& options) {
  facet::gpu::ContextOptions context_options;
  context_options.device = options.device;
  facet::gpu::Context context(context_options);
  Table table;
  std::optional<facet::face::FaceModel> model;
  for (const std::string& scene : options.scenes) {
    std::optional<facet::simulation::VirtualBooth> booth;
    if (scene == "actor" || scene == "still" || scene.rfind("booth-", 0) == 0) {
      const facet::simulation::VirtualBoothConfig config = facet::bench::booth_config(scene, options.scene);
      if (config.scene == facet::simulation::BoothScene::Actor && !model) {
        model = facet::face::FaceModel::load(options.model);
      }
      booth.emplace(model ? &*model : nullptr, config);
    }
    if (options.methods == std::vector<std::string>{"skin"}) {
      if (scene != "actor") {
        throw facet::Error(facet::ErrorKind::Usage, "skin is the actor's");
      }
      run_skin(context, *booth, options);
      continue;
    }
    const StereoFootage footage =
        booth ? facet::bench::booth_footage(*booth, scene, options.pair, options.scene)
              : facet::bench::scene_footage(scene, options.scene);
    for (const std::string& method : options.methods) {
      if (method == "structured") {
        if (!booth || (scene == "actor" && options.scene.compensation < 0)) {
          throw facet::Error(facet::ErrorKind::Usage,
                             "structured light is for still, booth-plane and booth-sphere, and for the actor "
                             "with --compensation");
        }
        run_structured(*booth, scene, options, table);
        continue;
      }
      Result result{&footage, {}};
      if (method == "windows") {
        result.maps = facet::bench::match_windows(footage);
      } else if (method == "sgbm") {
        result.maps = facet::bench::match_sgbm(footage);
      } else {
        result.maps = spacetime(context, footage, options, options.stereo, method);
      }
      table.add(scene, method, result);
      if (!options.pictures.empty()) {
        draw(options.pictures, fmt::format("{}-{}", scene, method), result);
      }
    }
  }
  table.print();
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  options.decode.response = facet::scan::Response::Srgb;  // the booth's cameras
  CLI::App app("Depth maps of footage whose depth is known: error, fill, ridges and time");
  app.add_option("--scenes", options.scenes,
                 "actor, still, booth-plane, booth-sphere; plane, sphere, wave, step")
      ->delimiter(',');
  app.add_option(
         "--methods", options.methods,
         "global, local, direct, frame, start, windows, sgbm, vector (global, and its time beside "
         "hand-written C++), structured (light, of still scenes); skin alone: fill of both pairs by angle")
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
  app.add_option("--start-on", options.start_on, "best, host or device")
      ->check(CLI::IsMember({"best", "host", "device"}));
  app.add_option("--repeat", options.repeat, "matches of each scene; shown are the times of the last");
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
  app.add_option("--part-bytes", options.stereo.spacetime.part_bytes, "of window sums at a time");
  app.add_option("--window-x", options.stereo.spacetime.window_x);
  app.add_option("--window-y", options.stereo.spacetime.window_y);
  app.add_option("--window-t", options.stereo.spacetime.window_t);
  app.add_option("--straddle", options.stereo.spacetime.straddle_px);
  app.add_option("--noise", options.stereo.spacetime.noise);
  app.add_option("--program", options.program, "of the booth: stripes, fringes or a slot's words")
      ->capture_default_str();
  app.add_option("--sequence", options.sequence, "of structured light");
  app.add_option("--compensation", options.scene.compensation,
                 "of structured light with phase:4xF while the actor moves: the order of the binomial "
                 "self-compensation, 1, 3, 5");
  app.add_option("--smooth", options.decode.smooth_px, "of structured light's phases, px");
  app.add_option("--pictures", options.pictures, "folder for shaded reliefs");
  CLI11_PARSE(app, argc, argv);
  try {
    options.scene.program = facet::capture::parse_slot_program(options.program);
    run(options);
  } catch (const facet::Error& error) {
    fmt::print(stderr, "{}\n", error.what());
    return static_cast<int>(error.kind());
  }
  return 0;
}
