// Measures the coarse tracker alone, without refinement, against sequences of known geometry (`facet synth`):
// surface, drift over the skin, expression weights by name, depth, flicker on a still face, time.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "capture/rig_file.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "maths/srgb.hpp"
#include "mesh/mesh.hpp"
#include "report/evaluation.hpp"
#include "simulation/sensor.hpp"
#include "simulation/sequence.hpp"
#include "track/tracker.hpp"

namespace {

using facet::Frame;
using facet::track::Tracker;
using facet::track::TrackResult;

struct Options {
  std::filesystem::path model = facet::default_model_file();
  std::filesystem::path assets = facet::default_landmark_nets();
  std::vector<std::filesystem::path> folders;
  std::filesystem::path curves;  ///< folder for a table of weights per sequence
  int measure_every = 15;
  int still_frames = 60;
  bool live = false;
  bool known_camera = false;
  bool by_name = false;
  int cameras = 1;
};

/// Processor time of the calling thread, ms.
double thread_ms() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

class Mean {
 public:
  void add(double value) {
    sum_ += value;
    squares_ += value * value;
    ++count_;
  }
  double mean() const { return count_ > 0 ? sum_ / count_ : std::numeric_limits<double>::quiet_NaN(); }
  double deviation() const {
    return count_ > 0 ? std::sqrt(std::max(0.0, squares_ / count_ - mean() * mean()))
                      : std::numeric_limits<double>::quiet_NaN();
  }

 private:
  double sum_ = 0, squares_ = 0, count_ = 0;
};

/// How one measured curve follows the true one.
struct CurveFit {
  double correlation = std::numeric_limits<double>::quiet_NaN();
  double gain = std::numeric_limits<double>::quiet_NaN();  ///< slope of measured over true
};

CurveFit compare_curves(const std::vector<double>& truth, const std::vector<double>& measured) {
  const auto count = static_cast<double>(truth.size());
  double mean_truth = 0, mean_measured = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    mean_truth += truth[i] / count;
    mean_measured += measured[i] / count;
  }
  double tt = 0, tm = 0, mm = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    tt += (truth[i] - mean_truth) * (truth[i] - mean_truth);
    tm += (truth[i] - mean_truth) * (measured[i] - mean_measured);
    mm += (measured[i] - mean_measured) * (measured[i] - mean_measured);
  }
  CurveFit fit;
  if (tt > 0) {
    fit.gain = tm / tt;
    fit.correlation = mm > 0 ? tm / std::sqrt(tt * mm) : 0;
  }
  return fit;
}

struct Tracked {
  Eigen::Isometry3f camera_from_head;
  facet::mesh::Vertices vertices_mm;  ///< head frame; empty: no mesh
  std::vector<float> expression;
};

struct Sequence {
  std::string name;
  std::filesystem::path folder;
  std::vector<Frame> frames;
  std::vector<std::vector<Frame>> views;  ///< [frame][camera]
  facet::capture::Rig rig;                ///< of several cameras
  nlohmann::json document;
};

std::vector<Frame> read_video(const std::filesystem::path& file) {
  std::vector<Frame> frames;
  const auto camera = facet::camera::open_camera({.kind = "file", .path = file});
  camera->start();
  Frame frame;
  while (camera->next(frame, std::chrono::seconds(10)) == facet::CaptureOutcome::Delivered) {
    frames.push_back(frame);
  }
  return frames;
}

Sequence read_sequence(const std::filesystem::path& folder, int cameras) {
  Sequence sequence;
  sequence.name = folder.filename().string();
  sequence.folder = folder;
  std::ifstream stream(folder / "camera.json");
  sequence.document = nlohmann::json::parse(stream);
  sequence.frames = read_video(folder / "video.mkv");
  for (const Frame& frame : sequence.frames) {
    sequence.views.push_back({frame});
  }
  if (cameras > 1) {
    sequence.rig = facet::capture::read_rig(folder / "rig.toml");
    for (std::size_t k = 1; k < static_cast<std::size_t>(cameras); ++k) {
      const auto further = read_video(folder / (sequence.rig.cameras.at(k).name + ".mkv"));
      for (std::size_t f = 0; f < sequence.views.size(); ++f) {
        sequence.views[f].push_back(further.at(f));
      }
    }
  }
  return sequence;
}

Eigen::Isometry3f true_pose(const nlohmann::json& frame) {
  Eigen::Isometry3f pose = Eigen::Isometry3f::Identity();
  const auto values = frame.at("camera_from_head").get<std::vector<std::vector<float>>>();
  for (Eigen::Index row = 0; row < 3; ++row) {
    for (Eigen::Index column = 0; column < 4; ++column) {
      pose.matrix()(row, column) =
          values.at(static_cast<std::size_t>(row)).at(static_cast<std::size_t>(column));
    }
  }
  return pose;
}

/// Unit normals of the control mesh's vertices, [3][vertex_count].
Eigen::Matrix3Xf control_normals(const facet::mesh::Quads& quads, const facet::mesh::Vertices& vertices_mm) {
  Eigen::Matrix3Xf normals = Eigen::Matrix3Xf::Zero(3, vertices_mm.cols());
  for (Eigen::Index q = 0; q < quads.cols(); ++q) {
    const Eigen::Vector3f across = vertices_mm.col(quads(2, q)) - vertices_mm.col(quads(0, q));
    const Eigen::Vector3f along = vertices_mm.col(quads(3, q)) - vertices_mm.col(quads(1, q));
    for (Eigen::Index corner = 0; corner < 4; ++corner) {
      normals.col(quads(corner, q)) += across.cross(along);
    }
  }
  return normals.colwise().normalized();
}

class TruthRun {
 public:
  TruthRun(const facet::face::FaceModel& model, const Options& options, Sequence sequence)
      : model_(model), options_(options), sequence_(std::move(sequence)) {
    config_.landmark_nets = options.assets;
    for (std::size_t k = 1; k < static_cast<std::size_t>(options.cameras); ++k) {
      const facet::capture::Lens& lens = sequence_.rig.cameras.at(k).lens;
      config_.further_views.push_back(
          {{static_cast<float>(lens.fx_px), static_cast<float>(lens.fy_px), static_cast<float>(lens.cx_px),
            static_cast<float>(lens.cy_px), lens.width_px, lens.height_px},
           lens.camera_from_rig * sequence_.rig.cameras.front().lens.camera_from_rig.inverse()});
    }
    if (options.known_camera || options.cameras > 1) {
      const auto& document = sequence_.document;
      config_.intrinsics = facet::CameraIntrinsics{.fx = document.at("fx").get<float>(),
                                                   .fy = document.at("fy").get<float>(),
                                                   .cx = document.at("cx").get<float>(),
                                                   .cy = document.at("cy").get<float>(),
                                                   .width_px = document.at("width").get<int>(),
                                                   .height_px = document.at("height").get<int>()};
    }
    for (const std::string& name : model.expression_names) {
      std::vector<double> curve;
      for (const auto& frame : sequence_.document.at("frames")) {
        curve.push_back(frame.at("expression").value(name, 0.0));
      }
      truth_.push_back(std::move(curve));
    }
  }

  void run() {
    if (sequence_.frames.empty()) {
      throw facet::Error(facet::ErrorKind::UnreadableInput,
                         fmt::format("{}: no frames; make it with facet synth", sequence_.folder.string()));
    }
    Tracker tracker(model_, config_);
    if (!options_.live) {
      adopt_first_pass(tracker);
    }
    Mean time_ms;
    for (const std::vector<Frame>& views : sequence_.views) {
      const double before_ms = thread_ms();
      const TrackResult& result = tracker.process(views);
      time_ms.add(thread_ms() - before_ms);
      tracked_.push_back({result.camera_from_head,
                          result.has_mesh ? result.vertices_mm : facet::mesh::Vertices(), result.expression});
      camera_ = result.camera;
    }
    measure_weights();
    measure_turns();
    measure_surface();
    if (options_.cameras == 1) {
      measure_still(tracker);
    }
    const double true_focal = sequence_.document.at("fx").get<double>();
    fmt::print(
        "{:10} {:6.2f} {:6.2f} {:6.2f} | {:6.3f} {:6.3f} | {:6.3f} {:5.2f}  {:6.3f} {:5.2f}  {:6.3f} {:5.2f} "
        " "
        "{:6.3f} {:5.2f}  {:6.3f} {:5.2f} | {:6.1f} {:6.1f} | {:4.1f} {:5.1f} | {:6.4f} {:6.4f} | {:5.2f} "
        "{}\n",
        sequence_.name, surface_mm_.mean(), surface_mm_.deviation(), drift_mm_.mean(), all_weights_.mean(),
        used_weights_.mean(), jaw_.correlation, jaw_.gain, blink_left_.correlation, blink_left_.gain,
        blink_right_.correlation, blink_right_.gain, gaze_yaw_.correlation, gaze_yaw_.gain,
        gaze_pitch_.correlation, gaze_pitch_.gain, 100 * depth_.mean(),
        100 * (static_cast<double>(camera_.fx) / true_focal - 1), turn_deg_.mean(), worst_turn_deg_,
        still_camera_mm_.mean(), still_head_mm_.mean(), time_ms.mean(), missed_);
  }

  static void print_header() {
    fmt::print(
        "surface: mean, deviation, drift in mm | weights: mean absolute error of all, of those in use | "
        "correlation and gain: jawOpen, eyeBlinkLeft, eyeBlinkRight, gaze sideways, gaze up | error %: "
        "depth, "
        "focal | head's turn since the first mesh, error in degrees: mean, worst | still face, second "
        "difference "
        "mm: camera, head | ms | frames without a mesh\n");
  }

  const std::vector<Mean>& errors_by_name() const { return by_name_; }
  const std::vector<Mean>& measured_by_name() const { return measured_by_name_; }
  const std::vector<Mean>& truth_by_name() const { return truth_by_name_; }

 private:
  void adopt_first_pass(Tracker& tracker) {
    Tracker first(model_, config_);
    for (const std::vector<Frame>& views : sequence_.views) {
      first.process(views);
      if (first.person()) {
        break;
      }
    }
    first.settle_subject();
    if (!first.person()) {
      throw facet::Error(facet::ErrorKind::NoFace,
                         fmt::format("{}: the tracker found no face", sequence_.name));
    }
    tracker.adopt(*first.person(), sequence_.frames.front().width_px, sequence_.frames.front().height_px);
  }

  /// Curves of all frames with a mesh: the true and the measured one of a combination of weights.
  CurveFit follow(const std::vector<std::pair<std::string, double>>& parts) const {
    std::vector<double> truth, measured;
    for (std::size_t f = 0; f < tracked_.size(); ++f) {
      if (tracked_[f].vertices_mm.cols() == 0) {
        continue;
      }
      double a = 0, b = 0;
      for (const auto& [name, factor] : parts) {
        const int k = model_.expression_index(name);
        if (k >= 0) {
          a += factor * truth_[static_cast<std::size_t>(k)][f];
          b += factor * static_cast<double>(tracked_[f].expression[static_cast<std::size_t>(k)]);
        }
      }
      truth.push_back(a);
      measured.push_back(b);
    }
    return compare_curves(truth, measured);
  }

  void measure_weights() {
    constexpr double kInUse = 0.1;
    by_name_.resize(truth_.size());
    measured_by_name_.resize(truth_.size());
    truth_by_name_.resize(truth_.size());
    for (std::size_t f = 0; f < tracked_.size(); ++f) {
      if (tracked_[f].vertices_mm.cols() == 0) {
        ++missed_;
        continue;
      }
      for (std::size_t k = 0; k < truth_.size(); ++k) {
        const double error = static_cast<double>(tracked_[f].expression[k]) - truth_[k][f];
        all_weights_.add(std::abs(error));
        by_name_[k].add(std::abs(error));
        measured_by_name_[k].add(static_cast<double>(tracked_[f].expression[k]));
        truth_by_name_[k].add(truth_[k][f]);
        if (*std::max_element(truth_[k].begin(), truth_[k].end()) >= kInUse) {
          used_weights_.add(std::abs(error));
        }
      }
    }
    jaw_ = follow({{"jawOpen", 1}});
    blink_left_ = follow({{"eyeBlinkLeft", 1}});
    blink_right_ = follow({{"eyeBlinkRight", 1}});
    gaze_yaw_ = follow({{"eyeLookOutLeft", 0.5},
                        {"eyeLookInRight", 0.5},
                        {"eyeLookInLeft", -0.5},
                        {"eyeLookOutRight", -0.5}});
    gaze_pitch_ = follow({{"eyeLookUpLeft", 0.5},
                          {"eyeLookUpRight", 0.5},
                          {"eyeLookDownLeft", -0.5},
                          {"eyeLookDownRight", -0.5}});
    if (!options_.curves.empty()) {
      write_curves();
    }
  }

  void write_curves() const {
    std::ofstream stream(options_.curves / (sequence_.name + ".csv"));
    stream << "frame";
    for (const std::string& name : model_.expression_names) {
      stream << ',' << name << " true," << name;
    }
    stream << '\n';
    for (std::size_t f = 0; f < tracked_.size(); ++f) {
      stream << f;
      for (std::size_t k = 0; k < truth_.size(); ++k) {
        stream << fmt::format(",{:.3f},{:.3f}", truth_[k][f], tracked_[f].expression[k]);
      }
      stream << '\n';
    }
  }

  /// How far the head's turn since the first mesh is from the true one.
  void measure_turns() {
    constexpr double kDegrees = 57.29577951308232;
    std::optional<std::size_t> first;
    for (std::size_t f = 0; f < tracked_.size(); ++f) {
      if (tracked_[f].vertices_mm.cols() == 0) {
        continue;
      }
      first = first.value_or(f);
      const auto turn_since_first = [&](const Eigen::Isometry3f& now, const Eigen::Isometry3f& then) {
        return Eigen::Matrix3f(now.linear() * then.linear().transpose());
      };
      const auto& document = sequence_.document.at("frames");
      const Eigen::Matrix3f wrong =
          turn_since_first(tracked_[f].camera_from_head, tracked_[*first].camera_from_head) *
          turn_since_first(true_pose(document.at(f)), true_pose(document.at(*first))).transpose();
      const double error_deg = kDegrees * static_cast<double>(Eigen::AngleAxisf(wrong).angle());
      turn_deg_.add(error_deg);
      worst_turn_deg_ = std::max(worst_turn_deg_, error_deg);
    }
  }

  void measure_surface() {
    constexpr float kReachMm = 50;
    constexpr float kSteepest = 0.2588F;  // cosine of 75 degrees
    struct Attachment {
      std::int32_t triangle;
      Eigen::Vector2f barycentric;
      Eigen::Vector3f offset_mm;  ///< from the skin point to the vertex, in the head's axes
    };
    std::vector<Attachment> attached(static_cast<std::size_t>(model_.vertex_count()),
                                     {-1, {0, 0}, {0, 0, 0}});
    const auto step = static_cast<std::size_t>(std::max(options_.measure_every, 1));
    for (std::size_t f = 0; options_.measure_every > 0 && f < tracked_.size(); f += step) {
      const Tracked& mesh = tracked_[f];
      const Eigen::Isometry3f pose = true_pose(sequence_.document.at("frames").at(f));
      depth_.add(static_cast<double>(mesh.camera_from_head.translation().z() / pose.translation().z()) - 1);
      if (mesh.vertices_mm.cols() == 0) {
        continue;
      }
      facet::report::Reconstruction coarse;
      coarse.normals =
          mesh.camera_from_head.linear() * control_normals(model_.control.quads, mesh.vertices_mm);
      coarse.vertices_mm =
          (mesh.camera_from_head.linear() * mesh.vertices_mm).colwise() + mesh.camera_from_head.translation();
      for (std::int32_t v = 0; v < model_.vertex_count(); ++v) {
        const std::uint8_t region = model_.regions[static_cast<std::size_t>(v)];
        if (facet::face::has_region(region, facet::face::Region::Refinable) &&
            !facet::face::has_region(region, facet::face::Region::Boundary) &&
            -coarse.normals.col(v).dot(coarse.vertices_mm.col(v).normalized()) >= kSteepest) {
          coarse.measured.push_back(v);
        }
      }
      const facet::report::Truth truth(
          facet::simulation::read_truth_ply(facet::simulation::truth_file(sequence_.folder, f)));
      const auto comparison = facet::report::compare(coarse, truth, facet::report::Alignment::Similarity);
      for (std::size_t i = 0; i < coarse.measured.size(); ++i) {
        const std::int32_t v = coarse.measured[i];
        if (std::isfinite(comparison.signed_distance_mm[i])) {
          surface_mm_.add(static_cast<double>(std::abs(comparison.signed_distance_mm[i])));
        }
        const Eigen::Vector3f at =
            comparison.truth_from_reconstruction * Eigen::Vector3f(coarse.vertices_mm.col(v));
        Attachment& skin = attached[static_cast<std::size_t>(v)];
        if (f == 0) {
          const auto closest = truth.caster().closest_point(at, kReachMm);
          skin = {closest.triangle, closest.barycentric, pose.linear().transpose() * (at - closest.point_mm)};
        } else if (skin.triangle >= 0) {
          const Eigen::Vector3f now = facet::render::interpolate(truth.mesh().triangles, skin.triangle,
                                                                 skin.barycentric, truth.mesh().vertices_mm);
          drift_mm_.add(
              static_cast<double>((pose.linear().transpose() * (at - now) - skin.offset_mm).norm()));
        }
      }
    }
  }

  /// The sequence's last frame again and again, each time through the sensor with new noise.
  void measure_still(Tracker& tracker) {
    constexpr int kSettling = 20;
    const Frame& frame = sequence_.frames.back();
    const Eigen::Index pixels = Eigen::Index{frame.width_px} * frame.height_px;
    Eigen::MatrixXf light(3, pixels);
    for (int y = 0; y < frame.height_px; ++y) {
      const std::uint8_t* row = frame.row(y);
      for (int x = 0; x < frame.width_px; ++x) {
        for (int c = 0; c < 3; ++c) {
          light(c, Eigen::Index{y} * frame.width_px + x) =
              facet::maths::decode_srgb(static_cast<float>(row[4 * x + c]) / 255.0F);
        }
      }
    }
    facet::mesh::Vertices head[3], camera[3];
    for (int k = 0; k < options_.still_frames; ++k) {
      const auto bytes = facet::simulation::develop(light, frame.width_px, frame.height_px, {},
                                                    static_cast<std::uint64_t>(1000 + k));
      Frame noisy = copy_with(frame, bytes);
      noisy.sequence = frame.sequence + 1 + static_cast<std::uint64_t>(k);
      noisy.media_time_ns = frame.media_time_ns + (k + 1) * 33'333'333LL;
      const TrackResult& result = tracker.process(noisy);
      if (!result.has_mesh) {
        return;
      }
      head[k % 3] = result.vertices_mm;
      camera[k % 3] = (result.camera_from_head.linear() * result.vertices_mm).colwise() +
                      result.camera_from_head.translation();
      if (k >= kSettling) {
        const int a = (k - 2) % 3, b = (k - 1) % 3, c = k % 3;
        for (std::int32_t v = 0; v < model_.vertex_count(); ++v) {
          if (facet::face::has_region(model_.regions[static_cast<std::size_t>(v)],
                                      facet::face::Region::Refinable)) {
            still_head_mm_.add(
                static_cast<double>((head[a].col(v) - 2 * head[b].col(v) + head[c].col(v)).norm()));
            still_camera_mm_.add(
                static_cast<double>((camera[a].col(v) - 2 * camera[b].col(v) + camera[c].col(v)).norm()));
          }
        }
      }
    }
  }

  static Frame copy_with(const Frame& like, const std::vector<std::uint8_t>& rgb) {
    Frame frame = like;
    frame.stride_bytes = 4 * static_cast<std::size_t>(like.width_px);
    const std::size_t count =
        static_cast<std::size_t>(like.width_px) * static_cast<std::size_t>(like.height_px);
    const std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[4 * count]);
    for (std::size_t i = 0; i < count; ++i) {
      std::copy_n(rgb.begin() + static_cast<std::ptrdiff_t>(3 * i), 3, pixels.get() + 4 * i);
      pixels[4 * i + 3] = 255;
    }
    frame.pixels = pixels;
    return frame;
  }

  const facet::face::FaceModel& model_;
  const Options& options_;
  Sequence sequence_;
  facet::track::TrackerConfig config_;
  std::vector<std::vector<double>> truth_;  ///< [expression][frame]
  std::vector<Tracked> tracked_;
  facet::CameraIntrinsics camera_;
  Mean surface_mm_, drift_mm_, all_weights_, used_weights_, depth_, turn_deg_, still_head_mm_,
      still_camera_mm_;
  double worst_turn_deg_ = 0;
  std::vector<Mean> by_name_, measured_by_name_, truth_by_name_;
  CurveFit jaw_, blink_left_, blink_right_, gaze_yaw_, gaze_pitch_;
  int missed_ = 0;
};

void print_names(const facet::face::FaceModel& model, const std::vector<TruthRun>& runs) {
  fmt::print("\n{:22} {:>7} {:>9} {:>7}\n", "weight", "true", "measured", "error");
  for (std::size_t k = 0; k < model.expression_names.size(); ++k) {
    Mean truth, measured, error;
    for (const TruthRun& run : runs) {
      truth.add(run.truth_by_name()[k].mean());
      measured.add(run.measured_by_name()[k].mean());
      error.add(run.errors_by_name()[k].mean());
    }
    fmt::print("{:22} {:7.3f} {:9.3f} {:7.3f}\n", model.expression_names[k], truth.mean(), measured.mean(),
               error.mean());
  }
}

int run(const Options& options) {
  const auto model = facet::face::FaceModel::load(options.model);
  TruthRun::print_header();
  std::vector<TruthRun> runs;
  for (const auto& folder : options.folders) {
    runs.emplace_back(model, options, read_sequence(folder, options.cameras));
    runs.back().run();
  }
  if (options.by_name) {
    print_names(model, runs);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("Measures the coarse tracker against sequences of known geometry (facet synth)");
  app.add_option("--model", options.model, "face model")->capture_default_str();
  app.add_option("--landmark-nets", options.assets, "MediaPipe's packed nets")->capture_default_str();
  app.add_option("--measure-every", options.measure_every,
                 "frames from one measured surface to the next; 0: none")
      ->capture_default_str();
  app.add_option("--still-frames", options.still_frames, "frames of the still face; 0: none")
      ->capture_default_str();
  app.add_option("--curves", options.curves, "folder for a table of true and measured weights per sequence");
  app.add_flag("--live", options.live, "acquire while measuring, as live");
  app.add_flag("--known-camera", options.known_camera, "hand the true intrinsics to the tracker");
  app.add_option(
         "--cameras", options.cameras,
         "so many of the folders' calibrated cameras (facet synth --cameras), known; without the still "
         "face")
      ->capture_default_str()
      ->check(CLI::Range(1, 8));
  app.add_flag("--names", options.by_name, "mean weights and errors by name");
  app.add_option("folders", options.folders, "folders that facet synth wrote")->required();
  CLI11_PARSE(app, argc, argv);
  try {
    return run(options);
  } catch (const facet::Error& error) {
    fmt::print(stderr, "{}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
