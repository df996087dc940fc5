// Chooses the weights of the refinement's energies: runs the product's tracker and refiner over sequences
// with known geometry (`facet synth`), once per value of one setting, and prints how near the truth each
// comes.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "evaluation.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "gpu/context.hpp"
#include "pipeline/subject_builder.hpp"
#include "refine/refiner.hpp"
#include "simulation/sequence.hpp"
#include "track/tracker.hpp"

namespace {

using facet::Error;
using facet::ErrorKind;
using facet::Frame;
using facet::refine::RefinerConfig;

struct Options {
  std::filesystem::path model = facet::default_model_file();
  std::filesystem::path landmark_assets = facet::default_landmark_assets();
  std::vector<std::filesystem::path> folders;
  std::vector<std::string> base;    ///< NAME=VALUE
  std::vector<std::string> sweeps;  ///< NAME=VALUE,VALUE,...
  int measure_every = 4;
  float min_edge_px = 3;
  std::string coarse = "tracker";
  std::string albedo = "learned";
  std::string device = "auto";
  bool reach = false;
};

/// A setting of the refiner by name.
void set(RefinerConfig& config, const std::string& name, float value) {
  if (name == "w1") {
    config.weights.lighting_temporal = value;
  } else if (name == "w2") {
    config.weights.albedo_smooth = value;
  } else if (name == "w3") {
    config.weights.displacement_smooth = value;
  } else if (name == "w4") {
    config.weights.displacement_hierarchy = value;
  } else if (name == "w5") {
    config.weights.displacement_coarse = value;
  } else if (name == "fold") {
    config.fold_slope = value;
  } else if (name == "robust") {
    config.robust_scale = value;
  } else if (name == "metric") {
    config.metric_floor = value;
  } else if (name == "steps") {
    config.gauss_newton_steps = static_cast<int>(value);
  } else if (name == "pcg") {
    config.pcg_iterations = static_cast<int>(value);
  } else if (name == "albedo_frames") {
    config.albedo_frames = static_cast<int>(value);
  } else if (name == "fine_albedo") {
    config.fine_albedo = value != 0;
  } else if (name == "hierarchical") {
    config.hierarchical = value != 0;
  } else if (name == "paper") {
    config.paper_budget = value != 0;
  } else {
    throw Error(ErrorKind::Usage,
                fmt::format("no setting {}; there are w1 to w5, fold, robust, metric, steps, "
                            "pcg, albedo_frames, fine_albedo, hierarchical, paper",
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

/// A frame of which the truth is known.
struct MeasuredFrame {
  std::unique_ptr<facet::tools::Truth> truth;
  std::vector<std::int32_t> vertices;
  facet::simulation::Similarity truth_from_camera;  ///< that fits the coarse mesh best
};

struct TrackedFrame {
  Frame image;
  facet::CameraIntrinsics camera;
  Eigen::Isometry3f camera_from_head;
  facet::mesh::Vertices control_vertices_mm;
};

/// A sequence, tracked once; every setting is tried on the same coarse meshes.
struct Sequence {
  std::string name;
  std::shared_ptr<const facet::mesh::Albedo> true_albedo;  ///< where asked for
  std::shared_ptr<const facet::mesh::Subject> subject;
  std::vector<TrackedFrame> frames;
  std::map<std::size_t, MeasuredFrame> measured;
  facet::tools::Figures coarse;
};

std::vector<Frame> read_frames(const std::filesystem::path& video) {
  const auto camera = facet::camera::open_camera({.kind = "file", .path = video});
  camera->start();
  std::vector<Frame> frames;
  Frame frame;
  while (camera->next(frame, std::chrono::seconds(10)) == facet::CaptureOutcome::Delivered) {
    frames.push_back(frame);
  }
  return frames;
}

/// Tracks from the first frame on, with the subject that a first pass has estimated.
void track(const facet::face::FaceModel& model, const Options& options, const std::vector<Frame>& frames,
           Sequence& sequence) {
  facet::track::TrackerConfig config;
  config.landmark_assets = options.landmark_assets;
  facet::track::Tracker first_pass(model, config);
  for (const Frame& frame : frames) {
    first_pass.process(frame);
    if (first_pass.subject()) {
      break;
    }
  }
  first_pass.settle_subject();
  if (!first_pass.subject()) {
    throw Error(ErrorKind::NoFace, fmt::format("{}: the tracker found no face", sequence.name));
  }
  facet::track::Tracker tracker(model, config);
  tracker.adopt(*first_pass.subject(), frames.front().width_px, frames.front().height_px);
  facet::mesh::HierarchyOptions hierarchy;
  hierarchy.min_edge_px = options.min_edge_px;
  for (const Frame& frame : frames) {
    const facet::track::TrackResult& result = tracker.process(frame);
    if (result.state != facet::mesh::TrackingState::Tracking) {
      throw Error(ErrorKind::NoFace, fmt::format("{}: frame {} is not tracked; choose another sequence",
                                                 sequence.name, frame.sequence));
    }
    if (!sequence.subject) {
      facet::mesh::MeshFrame good;
      good.state = result.state;
      good.camera = result.camera;
      good.camera_from_head = result.camera_from_head;
      good.control_vertices_mm = result.vertices_mm;
      sequence.subject =
          facet::pipeline::build_subject(model, hierarchy, good, result.identity, result.subject);
    }
    sequence.frames.push_back({frame, result.camera, result.camera_from_head, result.vertices_mm});
  }
}

/// Coarse meshes as a perfect tracker would give them: true pose, and of the true shape what the model spans.
void take_truth(const facet::face::FaceModel& model, const Options& options,
                const std::filesystem::path& folder, const std::vector<Frame>& frames, Sequence& sequence) {
  std::ifstream stream(folder / "camera.json");
  const nlohmann::json document = nlohmann::json::parse(stream);
  facet::CameraIntrinsics camera;
  camera.fx = document.at("fx").get<float>();
  camera.fy = document.at("fy").get<float>();
  camera.cx = document.at("cx").get<float>();
  camera.cy = document.at("cy").get<float>();
  camera.width_px = frames.front().width_px;
  camera.height_px = frames.front().height_px;
  const auto identity = document.at("identity").get<std::vector<float>>();
  const facet::face::ExpressionBasis basis = model.contract_identity(identity);
  facet::mesh::HierarchyOptions hierarchy;
  hierarchy.min_edge_px = options.min_edge_px;
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const nlohmann::json& truth = document.at("frames").at(k);
    const auto pose = truth.at("camera_from_head").get<std::vector<std::vector<float>>>();
    TrackedFrame frame{frames[k], camera, Eigen::Isometry3f::Identity(), {}};
    for (Eigen::Index row = 0; row < 3; ++row) {
      for (Eigen::Index column = 0; column < 4; ++column) {
        frame.camera_from_head.matrix()(row, column) =
            pose.at(static_cast<std::size_t>(row)).at(static_cast<std::size_t>(column));
      }
    }
    std::vector<float> expression;
    for (const std::string& name : model.expression_names) {
      expression.push_back(truth.at("expression").value(name, 0.0F));
    }
    basis.evaluate(expression, frame.control_vertices_mm);
    if (k == 0) {
      facet::mesh::MeshFrame good;
      good.state = facet::mesh::TrackingState::Tracking;
      good.camera = camera;
      good.camera_from_head = frame.camera_from_head;
      good.control_vertices_mm = frame.control_vertices_mm;
      sequence.subject = facet::pipeline::build_subject(model, hierarchy, good, identity, 1);
    }
    sequence.frames.push_back(std::move(frame));
  }
}

facet::tools::Reconstruction reconstruct(const Sequence& sequence, const TrackedFrame& frame,
                                         const std::vector<float>& displacements_mm) {
  facet::tools::Reconstruction out;
  facet::mesh::rebuild_finest(*sequence.subject->hierarchy, frame.control_vertices_mm, displacements_mm,
                              out.vertices_mm, out.normals);
  for (Eigen::Index v = 0; v < out.vertices_mm.cols(); ++v) {
    out.vertices_mm.col(v) = frame.camera_from_head * out.vertices_mm.col(v).eval();
    out.normals.col(v) = frame.camera_from_head.linear() * out.normals.col(v).eval();
  }
  return out;
}

/// Compares with the truth under the coarse mesh's alignment, so that a setting can't gain by a better one.
facet::tools::Comparison compare_aligned(facet::tools::Reconstruction mesh, const MeasuredFrame& measured) {
  for (Eigen::Index v = 0; v < mesh.vertices_mm.cols(); ++v) {
    mesh.vertices_mm.col(v) = measured.truth_from_camera * Eigen::Vector3f(mesh.vertices_mm.col(v));
    mesh.normals.col(v) = measured.truth_from_camera.rotation * mesh.normals.col(v).eval();
  }
  mesh.measured = measured.vertices;
  return facet::tools::compare(mesh, *measured.truth, facet::tools::Alignment::None);
}

/// The true albedo at the finest vertices, at the truth's points nearest to the aligned coarse mesh.
std::shared_ptr<const facet::mesh::Albedo> true_albedo(const facet::tools::Reconstruction& coarse,
                                                       const MeasuredFrame& frame) {
  auto out = std::make_shared<facet::mesh::Albedo>();
  out->version = 1;
  constexpr float kReachMm = 50;
  const facet::simulation::TruthMesh& truth = frame.truth->mesh();
  for (Eigen::Index v = 0; v < coarse.vertices_mm.cols(); ++v) {
    const auto closest = frame.truth->caster().closest_point(
        frame.truth_from_camera * Eigen::Vector3f(coarse.vertices_mm.col(v)), kReachMm);
    const Eigen::Vector3f rho = closest.triangle < 0
                                    ? Eigen::Vector3f(Eigen::Vector3f::Constant(0.4F))
                                    : facet::render::interpolate(truth.triangles, closest.triangle,
                                                                 closest.barycentric, truth.albedo);
    out->linear_rgb.insert(out->linear_rgb.end(), rho.data(), rho.data() + 3);
  }
  return out;
}

Sequence load(const facet::face::FaceModel& model, const Options& options,
              const std::filesystem::path& folder) {
  Sequence sequence;
  sequence.name = folder.filename().string();
  const std::vector<Frame> frames = read_frames(folder / "video.mkv");
  if (frames.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: no frames; make it with facet synth", folder.string()));
  }
  if (options.coarse == "truth") {
    take_truth(model, options, folder, frames, sequence);
  } else {
    track(model, options, frames, sequence);
  }
  facet::tools::FigureSum sum;
  for (std::size_t k = 0; k < sequence.frames.size(); k += static_cast<std::size_t>(options.measure_every)) {
    const TrackedFrame& frame = sequence.frames[k];
    MeasuredFrame measured;
    measured.truth = std::make_unique<facet::tools::Truth>(
        facet::simulation::read_truth_ply(facet::simulation::truth_file(folder, frame.image.sequence)));
    facet::tools::Reconstruction coarse = reconstruct(sequence, frame, {});
    measured.vertices =
        facet::tools::measured_vertices(*sequence.subject, coarse.vertices_mm, coarse.normals);
    coarse.measured = measured.vertices;
    const auto comparison =
        facet::tools::compare(coarse, *measured.truth, facet::tools::Alignment::Similarity);
    measured.truth_from_camera = comparison.truth_from_reconstruction;
    sum.add(static_cast<std::int64_t>(k), measured.vertices, comparison, 0);
    if (options.albedo == "truth" && !sequence.true_albedo) {
      sequence.true_albedo = true_albedo(coarse, measured);
    }
    sequence.measured.emplace(k, std::move(measured));
  }
  sequence.coarse = sum.figures();
  fmt::print("{}: {} frames, levels", sequence.name, sequence.frames.size());
  for (const facet::mesh::Level& level : sequence.subject->hierarchy->levels) {
    fmt::print(" {}", level.vertex_count);
  }
  fmt::print(" vertices; coarse {:.3f} mm, {:.2f} deg\n", sequence.coarse.mean_mm,
             sequence.coarse.normal_error_deg);
  return sequence;
}

struct Score {
  double mean_mm = 0;
  double normal_deg = 0;
  double photometric_rms = 0;
  double trembling_mm = 0;  ///< rms change of the displacements from frame to frame
  double device_ms = 0;
};

Score refine(facet::gpu::Context& context, const facet::face::FaceModel& model, const Sequence& sequence,
             const RefinerConfig& config) {
  facet::refine::Refiner refiner(context, config);
  refiner.set_subject(
      {sequence.subject->hierarchy, model.mean_albedo, model.control.refinable, sequence.true_albedo});
  facet::tools::FigureSum sum;
  Score score;
  std::vector<float> previous;
  double squares = 0;
  facet::refine::RefineOutput output;
  for (std::size_t k = 0; k < sequence.frames.size(); ++k) {
    const TrackedFrame& frame = sequence.frames[k];
    refiner.submit({frame.image, frame.camera, frame.camera_from_head, &frame.control_vertices_mm});
    if (refiner.collect(output) != facet::refine::RefineOutcome::Refined) {
      throw Error(ErrorKind::Internal, fmt::format("{}: frame {}: {}", sequence.name, k, output.failure));
    }
    score.device_ms += static_cast<double>(output.upload_ms + output.lighting_ms + output.albedo_ms +
                                           output.displacement_ms + output.readback_ms);
    for (std::size_t v = 0; v < previous.size(); ++v) {
      squares += std::pow(static_cast<double>(output.displacements_mm[v] - previous[v]), 2);
    }
    previous = output.displacements_mm;
    const auto measured = sequence.measured.find(k);
    if (measured != sequence.measured.end()) {
      const auto comparison =
          compare_aligned(reconstruct(sequence, frame, output.displacements_mm), measured->second);
      sum.add(static_cast<std::int64_t>(k), measured->second.vertices, comparison,
              static_cast<double>(output.photometric_rms));
    }
  }
  const facet::tools::Figures figures = sum.figures();
  const auto count = static_cast<double>(sequence.frames.size());
  score.mean_mm = figures.mean_mm;
  score.normal_deg = figures.normal_error_deg;
  score.photometric_rms = figures.photometric_rms;
  score.trembling_mm = std::sqrt(squares / (static_cast<double>(previous.size()) * std::max(1.0, count - 1)));
  score.device_ms /= count;
  return score;
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
    const Score score = refine(context, model, sequence, config);
    const double normal = 100 * (score.normal_deg / sequence.coarse.normal_error_deg - 1);
    const double distance = 100 * (score.mean_mm / sequence.coarse.mean_mm - 1);
    fmt::print(" {:6.2f} {:+6.1f}% {:+6.1f}%", score.normal_deg, normal, distance);
    const double share = 1 / static_cast<double>(sequences.size());
    normal_change += share * normal;
    distance_change += share * distance;
    total.photometric_rms += share * score.photometric_rms;
    total.trembling_mm += share * score.trembling_mm;
    total.device_ms += share * score.device_ms;
  }
  fmt::print(" | {:+6.1f}% {:+6.1f}%  {:.4f}  {:.4f}  {:6.1f}\n", normal_change, distance_change,
             total.photometric_rms, total.trembling_mm, total.device_ms);
  std::fflush(stdout);
}

/// Displacements that reach the truth along the coarse normals, each smoothed over its ring `rounds` times.
std::vector<float> true_displacements(const Sequence& sequence, const TrackedFrame& frame,
                                      const MeasuredFrame& measured, int rounds) {
  const facet::tools::Reconstruction coarse = reconstruct(sequence, frame, {});
  const facet::simulation::Similarity& to_truth = measured.truth_from_camera;
  const float bound_mm = RefinerConfig().displacement_bound_mm;
  std::vector<float> displacements_mm(static_cast<std::size_t>(coarse.vertices_mm.cols()), 0.0F);
  for (const std::int32_t v : measured.vertices) {
    const Eigen::Vector3f at = to_truth * Eigen::Vector3f(coarse.vertices_mm.col(v));
    const Eigen::Vector3f normal = to_truth.rotation * coarse.normals.col(v);
    const auto outwards = measured.truth->caster().first_hit(at, normal);
    const auto inwards = measured.truth->caster().first_hit(at, -normal);
    const bool is_inside =
        outwards.triangle >= 0 && (inwards.triangle < 0 || outwards.distance_mm < inwards.distance_mm);
    if (is_inside || inwards.triangle >= 0) {
      const float reach_mm = (is_inside ? outwards.distance_mm : -inwards.distance_mm) / to_truth.scale;
      displacements_mm[static_cast<std::size_t>(v)] = std::abs(reach_mm) < bound_mm ? reach_mm : 0;
    }
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
      facet::tools::FigureSum sum;
      for (const auto& [k, measured] : sequence.measured) {
        const TrackedFrame& frame = sequence.frames[k];
        const auto mesh = reconstruct(sequence, frame, true_displacements(sequence, frame, measured, rounds));
        sum.add(static_cast<std::int64_t>(k), measured.vertices, compare_aligned(mesh, measured), 0);
      }
      const facet::tools::Figures figures = sum.figures();
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
  const facet::face::FaceModel model = facet::face::FaceModel::load(options.model);
  facet::gpu::ContextOptions context_options;
  context_options.device = options.device;
  facet::gpu::Context context(context_options);
  std::vector<Sequence> sequences;
  for (const std::filesystem::path& folder : options.folders) {
    sequences.push_back(load(model, options, folder));
  }
  fmt::print(
      "\nPer sequence: normal error in degrees, its change and the mean distance's change against the coarse "
      "mesh.\nThen: both changes averaged, photometric rms, rms change of displacements per frame (mm), "
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
