#include "truth_sequence.hpp"

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "camera/factory.hpp"
#include "face/face_parts.hpp"
#include "face/subject_builder.hpp"
#include "facet/error.hpp"
#include "person/skin_follower.hpp"
#include "report/skin_points.hpp"
#include "simulation/sequence.hpp"
#include "track/tracker.hpp"

namespace facet::bench {
namespace {

std::vector<Frame> read_frames(const std::filesystem::path& video) {
  const auto camera = camera::open_camera({.kind = "file", .path = video});
  camera->start();
  std::vector<Frame> frames;
  Frame frame;
  while (camera->next(frame, std::chrono::seconds(10)) == CaptureOutcome::Delivered) {
    frames.push_back(frame);
  }
  return frames;
}

/// Tracks from the first frame on, with the subject that a first pass has estimated.
void track(const face::FaceModel& model, const SequenceOptions& options, const std::vector<Frame>& frames,
           Sequence& sequence) {
  track::TrackerConfig config;
  config.landmark_nets = options.landmark_nets;
  track::Tracker first_pass(model, config);
  for (const Frame& frame : frames) {
    first_pass.process(frame);
    if (first_pass.person()) {
      break;
    }
  }
  first_pass.settle_subject();
  if (!first_pass.person()) {
    throw Error(ErrorKind::NoFace, fmt::format("{}: the tracker found no face", sequence.name));
  }
  track::Tracker tracker(model, config);
  tracker.adopt(*first_pass.person(), frames.front().width_px, frames.front().height_px);
  mesh::HierarchyOptions hierarchy;
  hierarchy.min_edge_px = options.min_edge_px;
  std::optional<person::SkinFollower> follower;
  person::FollowedHead followed;
  if (options.follow_skin && !model.skin.albedo.empty()) {
    follower.emplace(model);
  }
  for (const Frame& frame : frames) {
    const track::TrackResult& result = tracker.process(frame);
    if (result.state != mesh::TrackingState::Tracking) {
      throw Error(ErrorKind::NoFace, fmt::format("{}: frame {} is not tracked; choose another sequence",
                                                 sequence.name, frame.sequence));
    }
    if (!sequence.subject) {
      mesh::MeshFrame good;
      good.state = result.state;
      good.camera = result.camera;
      good.camera_from_head = result.camera_from_head;
      good.control_vertices_mm = result.vertices_mm;
      sequence.subject = face::build_subject(model, hierarchy, good, result.identity, result.subject);
    }
    sequence.frames.push_back({frame, result.camera, result.camera_from_head, result.vertices_mm});
    if (follower) {
      follower->follow(frame, result, followed);
      sequence.frames.back().camera_from_head = followed.camera_from_head;
      sequence.frames.back().control_vertices_mm = followed.vertices_mm;
    }
  }
}

/// Coarse meshes as a perfect tracker would give them: true pose, and of the true shape what the model spans.
void take_truth(const face::FaceModel& model, const SequenceOptions& options,
                const std::filesystem::path& folder, const std::vector<Frame>& frames, Sequence& sequence) {
  std::ifstream stream(folder / "camera.json");
  const nlohmann::json document = nlohmann::json::parse(stream);
  CameraIntrinsics camera;
  camera.fx = document.at("fx").get<float>();
  camera.fy = document.at("fy").get<float>();
  camera.cx = document.at("cx").get<float>();
  camera.cy = document.at("cy").get<float>();
  camera.width_px = frames.front().width_px;
  camera.height_px = frames.front().height_px;
  const auto identity = document.at("identity").get<std::vector<float>>();
  const face::ExpressionBasis basis = model.contract_identity(identity);
  mesh::HierarchyOptions hierarchy;
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
      mesh::MeshFrame good;
      good.state = mesh::TrackingState::Tracking;
      good.camera = camera;
      good.camera_from_head = frame.camera_from_head;
      good.control_vertices_mm = frame.control_vertices_mm;
      sequence.subject = face::build_subject(model, hierarchy, good, identity, 1);
    }
    sequence.frames.push_back(std::move(frame));
  }
}

/// The true albedo at the finest vertices, at the truth's points nearest to the aligned coarse mesh.
std::shared_ptr<const mesh::Albedo> true_albedo(const report::Reconstruction& coarse,
                                                const MeasuredFrame& frame) {
  auto out = std::make_shared<mesh::Albedo>();
  out->version = 1;
  constexpr float kReachMm = 50;
  const simulation::TruthMesh& truth = frame.truth->mesh();
  for (Eigen::Index v = 0; v < coarse.vertices_mm.cols(); ++v) {
    const auto closest = frame.truth->caster().closest_point(
        frame.truth_from_camera * Eigen::Vector3f(coarse.vertices_mm.col(v)), kReachMm);
    const Eigen::Vector3f rho = closest.triangle < 0 ? Eigen::Vector3f(Eigen::Vector3f::Constant(0.4F))
                                                     : render::interpolate(truth.triangles, closest.triangle,
                                                                           closest.barycentric, truth.albedo);
    out->linear_rgb.insert(out->linear_rgb.end(), rho.data(), rho.data() + 3);
  }
  return out;
}

}  // namespace

report::Reconstruction reconstruct(const Sequence& sequence, const TrackedFrame& frame,
                                   const std::vector<float>& displacements_mm) {
  report::Reconstruction out;
  mesh::rebuild_finest(*sequence.subject->hierarchy, frame.control_vertices_mm, displacements_mm,
                       out.vertices_mm, out.normals);
  for (Eigen::Index v = 0; v < out.vertices_mm.cols(); ++v) {
    out.vertices_mm.col(v) = frame.camera_from_head * out.vertices_mm.col(v).eval();
    out.normals.col(v) = frame.camera_from_head.linear() * out.normals.col(v).eval();
  }
  return out;
}

report::Comparison compare_aligned(report::Reconstruction mesh, const MeasuredFrame& measured) {
  for (Eigen::Index v = 0; v < mesh.vertices_mm.cols(); ++v) {
    mesh.vertices_mm.col(v) = measured.truth_from_camera * Eigen::Vector3f(mesh.vertices_mm.col(v));
    mesh.normals.col(v) = measured.truth_from_camera.rotation * mesh.normals.col(v).eval();
  }
  mesh.measured = measured.vertices;
  return report::compare(mesh, *measured.truth, report::Alignment::None);
}

Sequence load_sequence(const face::FaceModel& model, const SequenceOptions& options,
                       const std::filesystem::path& folder) {
  Sequence sequence;
  sequence.name = folder.filename().string();
  // bench/gpu-day leaves it in a container that is read without FFmpeg.
  const bool repacked = std::filesystem::exists(folder / "video.avi");
  const std::vector<Frame> frames = read_frames(folder / (repacked ? "video.avi" : "video.mkv"));
  if (frames.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("{}: no frames; make it with facet synth", folder.string()));
  }
  if (options.coarse == "truth") {
    take_truth(model, options, folder, frames, sequence);
  } else {
    track(model, options, frames, sequence);
  }
  report::FigureSum sum;
  report::SkinPointSum skin_points;
  for (std::size_t k = 0; k < sequence.frames.size(); k += static_cast<std::size_t>(options.measure_every)) {
    const TrackedFrame& frame = sequence.frames[k];
    MeasuredFrame measured;
    measured.truth = std::make_unique<report::Truth>(
        simulation::read_truth_ply(simulation::truth_file(folder, frame.image.sequence)));
    report::Reconstruction coarse = reconstruct(sequence, frame, {});
    measured.vertices = report::measured_vertices(*sequence.subject, coarse.vertices_mm, coarse.normals);
    coarse.measured = measured.vertices;
    const auto comparison = report::compare(coarse, *measured.truth, report::Alignment::Similarity);
    measured.truth_from_camera = comparison.truth_from_reconstruction;
    measured.true_displacements_mm =
        report::true_displacements_mm(coarse, measured.truth_from_camera, *measured.truth);
    sum.add(static_cast<std::int64_t>(k), measured.vertices, comparison, 0);
    skin_points.add(sequence.subject->id, static_cast<double>(k), coarse, comparison, measured.truth->mesh());
    if (options.albedo == "truth" && !sequence.true_albedo) {
      sequence.true_albedo = true_albedo(coarse, measured);
    }
    sequence.measured.emplace(k, std::move(measured));
  }
  sequence.coarse = sum.figures();
  fmt::print("{}: {} frames, levels", sequence.name, sequence.frames.size());
  for (const mesh::Level& level : sequence.subject->hierarchy->levels) {
    fmt::print(" {}", level.vertex_count);
  }
  const report::SkinPointFigures skin = skin_points.figures();
  fmt::print(" vertices; coarse {:.3f} mm, {:.2f} deg, the same skin {:.3f} mm off, {:.3f} along it\n",
             sequence.coarse.mean_mm, sequence.coarse.normal_error_deg, skin.mean_mm, skin.tangential_mm);
  return sequence;
}

Score refine_sequence(gpu::Context& context, const face::FaceModel& model, const Sequence& sequence,
                      const refine::RefinerConfig& config,
                      const std::function<void(std::size_t, const refine::RefineOutput&)>& at_measured) {
  refine::Refiner refiner(context, config);
  refine::SubjectSetup setup{sequence.subject->hierarchy, model.mean_albedo,
                             model.control.refinable,     sequence.true_albedo,
                             face::shading_trust(model),  model.identity_count() == 0};
  face::KnownSkin skin = face::known_skin(model, *sequence.subject->hierarchy);
  setup.relief_mm = std::move(skin.relief_mm);
  if (sequence.true_albedo == nullptr) {
    setup.skin_albedo = std::move(skin.albedo);
  }
  refiner.set_subject(setup);
  report::FigureSum sum;
  report::WrinkleSum wrinkles;
  Score score;
  std::vector<float> previous;
  double squares = 0;
  refine::RefineOutput output;
  for (std::size_t k = 0; k < sequence.frames.size(); ++k) {
    const TrackedFrame& frame = sequence.frames[k];
    refiner.submit({frame.image, frame.camera, frame.camera_from_head, &frame.control_vertices_mm});
    if (refiner.collect(output) != refine::RefineOutcome::Refined) {
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
      report::Reconstruction coarse = reconstruct(sequence, frame, {});
      coarse.measured = measured->second.vertices;
      wrinkles.add(sequence.subject->hierarchy->finest().one_rings, coarse,
                   measured->second.true_displacements_mm, output.displacements_mm);
      if (at_measured) {
        at_measured(k, output);
      }
    }
  }
  const report::AccuracyFigures figures = sum.figures();
  const auto count = static_cast<double>(sequence.frames.size());
  score.mean_mm = figures.mean_mm;
  score.normal_deg = figures.normal_error_deg;
  score.photometric_rms = figures.photometric_rms;
  score.wrinkle_correlation = wrinkles.correlation();
  score.wrinkle_depth = wrinkles.depth();
  score.trembling_mm = std::sqrt(squares / (static_cast<double>(previous.size()) * std::max(1.0, count - 1)));
  score.device_ms /= count;
  return score;
}

}  // namespace facet::bench
