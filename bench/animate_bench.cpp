// Posing and animating takes: how long it takes, and how it looks beside other ways. Commands and results
// stand in results/animation.md.

#include <fmt/format.h>
#include <sys/resource.h>

#include <CLI/CLI.hpp>
#include <Eigen/Cholesky>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "animate/animation.hpp"
#include "animate/face_graph.hpp"
#include "animate/face_ik.hpp"
#include "animate/places.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "mesh/hierarchy.hpp"
#include "progress.hpp"
#include "report/take_pictures.hpp"
#include "simulation/actor_take.hpp"
#include "take/reader.hpp"
#include "take/recorder.hpp"

namespace facet {
namespace {

using animate::ControlTarget;
using animate::FaceIk;
using animate::Pose;
using animate::TakeBasis;

struct Options {
  std::string model = default_model_file().string();
  std::string folder = ".";
  std::string take;
  std::uint64_t seed = 1;
  int frames = 600;
  std::int32_t vertices = 16'000;
  int controls = 8;
  int events = 300;
  bool graph = true;
};

double seconds(clockid_t clock) {
  timespec now{};
  ::clock_gettime(clock, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// Wall and processor time of a piece of work.
class Timer {
 public:
  std::string text() const {
    return fmt::format("{:.1f} s, {:.1f} s of processor", seconds(CLOCK_MONOTONIC) - wall_s_,
                       seconds(CLOCK_PROCESS_CPUTIME_ID) - processor_s_);
  }

 private:
  double wall_s_ = seconds(CLOCK_MONOTONIC);
  double processor_s_ = seconds(CLOCK_PROCESS_CPUTIME_ID);
};

double peak_mib() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

void record(const std::filesystem::path& file, int frames,
            const std::function<std::shared_ptr<const mesh::MeshFrame>(int)>& make) {
  take::TakeRecorderConfig config;
  config.file = file;
  config.source = "virtual actor";
  config.software = "animate_bench";
  config.when_full = take::WhenFull::Wait;
  take::TakeRecorder recorder(config);
  recorder.start();
  tools::Progress progress("Performing", static_cast<std::uint64_t>(frames));
  for (int index = 0; index < frames; ++index) {
    recorder.record(make(index));
    progress.advance();
  }
  if (recorder.stop().state == take::RecorderState::Failed) {
    throw Error(ErrorKind::Storage, recorder.status().reason);
  }
}

std::filesystem::path actor_take(const Options& options) {
  const std::filesystem::path file =
      std::filesystem::path(options.folder) /
      fmt::format("actor{}-{}-{}.take", options.seed, options.frames, options.vertices);
  if (!std::filesystem::exists(file)) {
    const face::FaceModel model = face::FaceModel::load(options.model);
    const simulation::ActorTake actor(model, {options.seed, options.frames, 60, options.vertices});
    record(file, options.frames, [&](int index) { return actor.frame(index); });
  }
  return file;
}

/// Vertices of the moving part of the face, far from each other.
std::vector<std::int32_t> choose_controls(const TakeBasis& basis, int count, std::mt19937& random) {
  // Motion of every control vertex over the take.
  std::vector<std::int32_t> chosen;
  std::vector<std::pair<float, std::int32_t>> moving;
  const Eigen::MatrixXf covariance = basis.coefficients().topRows(basis.coarse_rank()) *
                                     basis.coefficients().topRows(basis.coarse_rank()).transpose() /
                                     static_cast<float>(basis.frame_count());
  for (std::int32_t v = 0; v < basis.control_count(); ++v) {
    const Eigen::MatrixXf axes = basis.coarse().middleCols<3>(Eigen::Index{3} * v);
    moving.emplace_back((axes.transpose() * covariance * axes).trace(), v);
  }
  std::sort(moving.rbegin(), moving.rend());
  moving.resize(moving.size() / 4);
  for (int tries = 0; tries < 100'000 && static_cast<int>(chosen.size()) < count; ++tries) {
    const std::int32_t vertex = moving[random() % moving.size()].second;
    const bool apart = std::all_of(chosen.begin(), chosen.end(), [&](std::int32_t other) {
      return (basis.rest_mm().col(other) - basis.rest_mm().col(vertex)).norm() > 15;
    });
    if (apart) {
      chosen.push_back(vertex);
    }
  }
  return chosen;
}

mesh::Vertices finest_of(const mesh::MeshFrame& frame) {
  mesh::Vertices vertices;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(*frame.subject->hierarchy, frame.control_vertices_mm, frame.displacements_mm, vertices,
                       normals);
  return vertices;
}

void print_times(const char* what, std::vector<double> times_ms) {
  std::sort(times_ms.begin(), times_ms.end());
  fmt::print("  {:<46} median {:6.2f} ms, 95 % {:6.2f} ms\n", what, times_ms[times_ms.size() / 2],
             times_ms[times_ms.size() * 95 / 100]);
}

/// How far faces lie from those whose weights are made of every captured face by itself.
void print_gathering(FaceIk& ik, std::vector<ControlTarget> targets, const mesh::Vertices& from,
                     const mesh::Vertices& to) {
  constexpr int kPoses = 24;
  std::vector<mesh::Vertices> gathered;
  mesh::MeshFrame frame = animate::blank_frame(ik.basis());
  Pose pose;
  double worst_mm = 0;
  double square_mm2 = 0;
  double moved_mm = 0;
  for (const bool every_face : {false, true}) {
    ik.set_options({.every_face = every_face});
    for (int k = 0; k < kPoses; ++k) {
      for (std::size_t i = 0; i < targets.size(); ++i) {
        // The last quarter of the poses beyond what was captured.
        const float part =
            (k < 3 * kPoses / 4 ? 1.0F : 2.5F) *
            (0.5F - 0.5F * std::cos(0.7F * static_cast<float>(k) * (1 + 0.2F * static_cast<float>(i))));
        targets[i].target = (1 - part) * from.col(targets[i].vertex) + part * to.col(targets[i].vertex);
      }
      ik.solve(targets, pose);
      animate::blend(ik.basis(), pose, frame);
      const mesh::Vertices made = finest_of(frame);
      if (!every_face) {
        gathered.push_back(made);
        continue;
      }
      const Eigen::VectorXf apart =
          (made - gathered[static_cast<std::size_t>(k)]).colwise().norm().transpose();
      worst_mm = std::max(worst_mm, static_cast<double>(apart.maxCoeff()));
      square_mm2 += static_cast<double>(apart.squaredNorm()) / static_cast<double>(apart.size()) / kPoses;
      moved_mm = std::max(moved_mm, static_cast<double>((made - from).colwise().norm().maxCoeff()));
    }
  }
  fmt::print(
      "  {} faces against weighing every captured face by itself: worst vertex {:.4f} mm, rms {:.5f} mm; the "
      "faces move by up to {:.1f} mm\n",
      kPoses, worst_mm, std::sqrt(square_mm2), moved_mm);
}

void run_time(const Options& options) {
  const std::filesystem::path take =
      options.take.empty() ? actor_take(options) : std::filesystem::path(options.take);
  animate::BasisOptions basis_options;
  basis_options.file = std::filesystem::path(options.folder) / "bench.basis";
  std::filesystem::remove(basis_options.file);
  const Timer basis_timer;
  const auto basis = TakeBasis::open(take, basis_options);
  const animate::BasisHeader& header = basis->header();
  fmt::print("{} faces, {} vertices of {} control vertices; {} + {} numbers\n", basis->frame_count(),
             basis->finest_count(), basis->control_count(), basis->coarse_rank(), basis->detail_rank());
  fmt::print(
      "  basis: {}; vertices within {:.4f} mm (rms {:.5f}), displacements within {:.4f} mm (rms {:.5f}); "
      "{:.0f} MiB\n",
      basis_timer.text(), header.coarse_max_mm, header.coarse_rms_mm, header.detail_max_mm,
      header.detail_rms_mm, peak_mib());
  if (options.graph) {
    const Timer graph_timer;
    const animate::FaceGraph graph(*basis, animate::RegionMetric(*basis));
    fmt::print("  graph: {}; {:.0f} MiB\n", graph_timer.text(), peak_mib());
    const Timer path_timer;
    const auto path = graph.shortest(0, graph.face_count() / 2);
    fmt::print("  shortest path: {}; {:.2f} mm of {:.2f} mm directly, {} faces\n", path_timer.text(),
               path.cost, path.direct_cost, path.faces.size());
  }
  std::mt19937 random(static_cast<unsigned>(options.seed));
  const auto vertices = choose_controls(*basis, options.controls, random);
  const auto captured = [&](const FaceIk&, int face) {
    Pose pose;
    pose.maps = std::make_shared<const animate::InfluenceMaps>(*basis, std::span<const std::int32_t>());
    pose.state = animate::captured_state(*basis, face);
    mesh::MeshFrame frame = animate::blank_frame(*basis);
    animate::blend(*basis, pose, frame);
    return finest_of(frame);
  };
  FaceIk ik(basis, {.whole = false, .beyond = true, .sharp_folds = true});
  const mesh::Vertices from = captured(ik, basis->frame_count() / 3);
  const mesh::Vertices to = captured(ik, 2 * basis->frame_count() / 3);
  std::vector<ControlTarget> targets;
  for (const std::int32_t vertex : vertices) {
    targets.push_back({vertex, ControlTarget::Space::Head, from.col(vertex)});
  }
  Pose pose;
  const Timer first_timer;
  ik.solve(targets, pose);
  fmt::print("  first solve with {} control points (their maps): {}\n", targets.size(), first_timer.text());
  mesh::MeshFrame frame = animate::blank_frame(*basis);
  mesh::Vertices made;
  Eigen::Matrix3Xf normals;
  for (const bool all_move : {false, true}) {
    std::vector<double> solve_ms;
    std::vector<double> blend_ms;
    std::vector<double> event_ms;
    std::vector<double> rebuild_ms;
    float worst_mm = 0;
    int missed = 0;
    for (int event = 0; event < options.events; ++event) {
      // To and fro between two captured faces, each point in its own time.
      for (std::size_t i = 0; i < targets.size(); ++i) {
        if (all_move || i == static_cast<std::size_t>(event / 40) % targets.size()) {
          const float part =
              0.5F - 0.5F * std::cos(0.05F * static_cast<float>(event) * (1 + 0.2F * static_cast<float>(i)));
          targets[i].target = (1 - part) * from.col(vertices[i]) + part * to.col(vertices[i]);
        }
      }
      const double begun = seconds(CLOCK_THREAD_CPUTIME_ID);
      const auto& outcomes = ik.solve(targets, pose);
      const double solved = seconds(CLOCK_THREAD_CPUTIME_ID);
      animate::blend(*basis, pose, frame);
      const double blended = seconds(CLOCK_THREAD_CPUTIME_ID);
      mesh::rebuild_finest(basis->hierarchy(), frame.control_vertices_mm, frame.displacements_mm, made,
                           normals);
      const double rebuilt = seconds(CLOCK_THREAD_CPUTIME_ID);
      solve_ms.push_back(1e3 * (solved - begun));
      blend_ms.push_back(1e3 * (blended - solved));
      event_ms.push_back(1e3 * (blended - begun));
      rebuild_ms.push_back(1e3 * (rebuilt - blended));
      for (std::size_t i = 0; i < targets.size(); ++i) {
        worst_mm = std::max(worst_mm, (made.col(vertices[i]) - targets[i].target).norm());
        missed += outcomes[i].met ? 0 : 1;
      }
    }
    fmt::print("  {} ({} events, one core's processor time):\n",
               all_move ? "all control points move" : "one control point is dragged", options.events);
    print_times("solve", solve_ms);
    print_times("blend to control vertices and displacements", blend_ms);
    print_times("event: both", event_ms);
    print_times("rebuild the finest mesh with normals", rebuild_ms);
    fmt::print("  worst miss {:.4f} mm; {} of {} not met\n", worst_mm, missed,
               options.events * static_cast<int>(targets.size()));
  }
  fmt::print("  peak memory {:.0f} MiB\n", peak_mib());
  print_gathering(ik, targets, from, to);
}

// --- Pictures
// -------------------------------------------------------------------------------------------------

constexpr int kCellWidth_px = 420;
constexpr int kCellHeight_px = 500;

render::Picture draw(const mesh::MeshFrame& frame) {
  const report::FrameGeometry geometry = report::geometry_of(frame);
  const mesh::Triangles& triangles = frame.subject->hierarchy->finest().triangles;
  const report::Cell cell =
      report::cell_around(report::face_vertices(frame), frame.camera, kCellWidth_px, kCellHeight_px);
  const render::Raycaster caster(geometry.refined_mm, triangles);
  return report::render_colours(caster, triangles, report::grey_shading(geometry.refined_normals),
                                cell.camera,
                                render::plain_picture(kCellWidth_px, kCellHeight_px, report::kPaper));
}

/// Cells in rows, each with a text.
class Sheet {
 public:
  Sheet(int columns, int rows)
      : picture_(render::plain_picture(columns * (kCellWidth_px + kGap_px), rows * (kCellHeight_px + kGap_px),
                                       report::kPaper)) {}
  void put(int column, int row, const render::Picture& cell, const std::string& text) {
    const int x = column * (kCellWidth_px + kGap_px);
    const int y = row * (kCellHeight_px + kGap_px);
    render::paste(picture_, cell, x, y);
    report::label_cell(picture_, x, y + kCellHeight_px, text);
  }
  void write(const std::filesystem::path& file) const { render::write_png(picture_, file); }

 private:
  static constexpr int kGap_px = 6;
  render::Picture picture_;
};

std::vector<float> expression_of(const face::FaceModel& model,
                                 std::initializer_list<std::pair<const char*, float>> parts) {
  std::vector<float> weights(static_cast<std::size_t>(model.expression_count()), 0.0F);
  for (const auto& [name, weight] : parts) {
    const int index = model.expression_index(name);
    if (index >= 0) {
      weights[static_cast<std::size_t>(index)] = weight;
    }
  }
  return weights;
}

/// Energy of what is narrower than a fold in a frame's displacements, mm rms.
double fold_energy(const TakeBasis& basis, const std::vector<float>& displacements) {
  const Eigen::MatrixXf folds =
      animate::narrow_part(basis.hierarchy(), basis.rest_mm(),
                           Eigen::Map<const Eigen::RowVectorXf>(displacements.data(), basis.finest_count()));
  return static_cast<double>(folds.norm()) / std::sqrt(static_cast<double>(folds.size()));
}

/// Captured faces taken out of the take and posed again by five of their points: folds averaged by the
/// weights and re-evaluated.
void run_folds(const Options& options) {
  const face::FaceModel model = face::FaceModel::load(options.model);
  Sheet sheet(3, 3);
  constexpr int kFrames = 600;
  fmt::print("{:>5} {:>6} {:>12} {:>12} {:>12} {:>14} {:>14}\n", "seed", "faces", "captured mm", "averaged %",
             "re-evaluated %", "error averaged", "re-evaluated");
  for (int row = 0; row < 3; ++row) {
    const std::uint64_t seed = options.seed + static_cast<std::uint64_t>(row);
    const simulation::ActorTake actor(model, {seed, kFrames, 30, 40'000});
    const auto file = std::filesystem::path(options.folder) / fmt::format("folds{}.take", seed);
    std::filesystem::remove(file);
    const auto held_out = [](int index) { return index % 60 >= 45 && index % 60 < 51; };
    record(file, kFrames,
           [&](int index) { return actor.frame(held_out(index) ? index - index % 60 + 44 : index); });
    const auto basis = TakeBasis::open(file);
    const Eigen::Isometry3f frontal = actor.shape(expression_of(model, {})).camera_from_head;
    FaceIk ik(basis, {.whole = false, .beyond = true, .sharp_folds = true});
    std::vector<std::int32_t> vertices;
    for (const char* place : {"mouth-left", "mouth-right", "lip-lower", "brow-left", "brow-right"}) {
      vertices.push_back(animate::find_vertex(*basis, place));
    }
    double real_energy = 0;
    double energies[2] = {0, 0};
    double errors[2] = {0, 0};
    double most_energy = -1;
    int faces = 0;
    for (int index = 48; index < kFrames; index += 60) {
      const mesh::MeshFrame real = *actor.frame(index);
      const mesh::Vertices at = finest_of(real);
      std::vector<ControlTarget> targets;
      for (const std::int32_t vertex : vertices) {
        targets.push_back({vertex, ControlTarget::Space::Head, at.col(vertex)});
      }
      const double energy = fold_energy(*basis, real.displacements_mm);
      real_energy += energy;
      mesh::MeshFrame made[2];
      for (int sharp = 0; sharp < 2; ++sharp) {
        ik.set_options({.whole = false, .beyond = true, .sharp_folds = sharp == 1});
        Pose pose;
        ik.solve(targets, pose);
        mesh::MeshFrame frame = animate::blank_frame(*basis);
        animate::blend(*basis, pose, frame);
        energies[sharp] += fold_energy(*basis, frame.displacements_mm);
        std::vector<float> apart = frame.displacements_mm;
        for (std::size_t v = 0; v < apart.size(); ++v) {
          apart[v] -= real.displacements_mm[v];
        }
        errors[sharp] += fold_energy(*basis, apart);
        frame.camera_from_head = frontal;
        made[sharp] = std::move(frame);
      }
      ++faces;
      if (energy > most_energy) {
        most_energy = energy;
        mesh::MeshFrame shown = real;
        shown.camera_from_head = frontal;
        sheet.put(0, row, draw(shown), fmt::format("captured, left out (seed {}, frame {})", seed, index));
        sheet.put(1, row, draw(made[0]), "posed by 5 points, folds averaged");
        sheet.put(2, row, draw(made[1]), "folds re-evaluated");
      }
    }
    fmt::print("{:>5} {:>6} {:>12.4f} {:>12.1f} {:>12.1f} {:>14.4f} {:>14.4f}\n", seed, faces,
               real_energy / faces, 100 * energies[0] / real_energy, 100 * energies[1] / real_energy,
               errors[0] / faces, errors[1] / faces);
  }
  sheet.write(std::filesystem::path(options.folder) / "animate-folds.png");
}

/// Maximum likelihood under PCA of one fixed region ([SF04 fig. 6]): of a Gaussian, the mean
/// face given the points, on the region; outside it the mean.
class RegionPca {
 public:
  RegionPca(std::shared_ptr<const TakeBasis> basis, std::vector<std::int32_t> vertices,
            const Eigen::VectorXf& mask)
      : basis_(std::move(basis)), vertices_(std::move(vertices)), mask_(mask) {
    const auto rows = static_cast<Eigen::Index>(3 * vertices_.size());
    points_.resize(rows, basis_->frame_count());
    Pose pose;
    pose.maps = std::make_shared<const animate::InfluenceMaps>(*basis_, std::span<const std::int32_t>());
    mesh::MeshFrame frame = animate::blank_frame(*basis_);
    for (int face = 0; face < basis_->frame_count(); ++face) {
      pose.state = animate::captured_state(*basis_, face);
      animate::blend(*basis_, pose, frame);
      const mesh::Vertices at = finest_of(frame);
      for (std::size_t i = 0; i < vertices_.size(); ++i) {
        points_.col(face).segment<3>(static_cast<Eigen::Index>(3 * i)) = at.col(vertices_[i]).cast<double>();
      }
    }
  }

  mesh::MeshFrame solve(const std::vector<ControlTarget>& targets) const {
    const Eigen::VectorXd mean = points_.rowwise().mean();
    const Eigen::MatrixXd apart = points_.colwise() - mean;
    Eigen::MatrixXd square = apart * apart.transpose() / static_cast<double>(basis_->frame_count());
    square.diagonal().array() += 0.02 * 0.02;
    Eigen::VectorXd offset(mean.size());
    for (std::size_t i = 0; i < targets.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(3 * i);
      offset.segment<3>(row) = targets[i].target.cast<double>() - mean.segment<3>(row);
    }
    const Eigen::MatrixXd cross = basis_->coefficients().cast<double>() * apart.transpose() /
                                  static_cast<double>(basis_->frame_count());
    coefficients_ = (cross * square.ldlt().solve(offset)).cast<float>();
    Pose pose;
    pose.maps = std::make_shared<const animate::InfluenceMaps>(*basis_, std::span<const std::int32_t>());
    pose.state = Eigen::MatrixXf::Zero(basis_->coefficient_count() + basis_->detail_rank(), 1);
    mesh::MeshFrame rest = animate::blank_frame(*basis_);
    animate::blend(*basis_, pose, rest);
    pose.state.topRows(basis_->coefficient_count()) = coefficients_;
    pose.state.bottomRows(basis_->detail_rank()) =
        coefficients_.segment(basis_->coarse_rank(), basis_->detail_rank());
    mesh::MeshFrame frame = animate::blank_frame(*basis_);
    animate::blend(*basis_, pose, frame);
    for (Eigen::Index c = 0; c < frame.control_vertices_mm.cols(); ++c) {
      frame.control_vertices_mm.col(c) =
          mask_[c] * frame.control_vertices_mm.col(c) + (1 - mask_[c]) * rest.control_vertices_mm.col(c);
    }
    return frame;
  }
  /// rms over the region's vertices from the last solution to the nearest captured face, mm.
  double nearest_mm() const {
    const animate::RegionMetric metric(*basis_, mask_,
                                       Eigen::VectorXf::Zero(basis_->finest_count()).array() + 1e-6F,
                                       Eigen::VectorXf::Zero(basis_->eye_count()));
    const Eigen::VectorXf at = metric.coordinates(coefficients_);
    return static_cast<double>(
        (metric.coordinates(basis_->coefficients()).colwise() - at).colwise().norm().minCoeff());
  }

 private:
  std::shared_ptr<const TakeBasis> basis_;
  std::vector<std::int32_t> vertices_;
  Eigen::VectorXf mask_;
  Eigen::MatrixXd points_;
  mutable Eigen::VectorXf coefficients_;
};

float worst_miss(const mesh::MeshFrame& frame, const std::vector<ControlTarget>& targets) {
  const mesh::Vertices at = finest_of(frame);
  float worst = 0;
  for (const ControlTarget& target : targets) {
    worst = std::max(worst, (at.col(target.vertex) - target.target).norm());
  }
  return worst;
}

/// The paper's figure 6: an asymmetric smile from a take whose smiles are all symmetric, and a mouth opened
/// by one point of the lip.
void run_regions(const Options& options) {
  const face::FaceModel model = face::FaceModel::load(options.model);
  fmt::print("{:>5} {:<34} {:<8} {:>9} {:>18}\n", "seed", "pose", "way", "miss mm", "nearest face mm");
  for (int trial = 0; trial < 3; ++trial) {
    const std::uint64_t seed = options.seed + static_cast<std::uint64_t>(trial);
    const simulation::ActorTake actor(model, {seed, 300, 30, 40'000});
    const auto file = std::filesystem::path(options.folder) / fmt::format("symmetric{}.take", seed);
    std::filesystem::remove(file);
    record(file, 300, [&](int index) {
      const auto time = static_cast<float>(index);
      const float smile = std::max(0.0F, std::sin(0.105F * time)) * 0.9F;
      const float jaw = std::max(0.0F, std::sin(0.17F * time + 1)) * 0.7F;
      const float pucker = std::max(0.0F, -std::sin(0.105F * time)) * 0.6F;
      const float brow = 0.5F - 0.5F * std::cos(0.13F * time);
      auto frame = std::make_shared<mesh::MeshFrame>(
          actor.shape(expression_of(model, {{"mouthSmileLeft", smile},
                                            {"mouthSmileRight", smile},
                                            {"cheekSquintLeft", 0.6F * smile},
                                            {"cheekSquintRight", 0.6F * smile},
                                            {"eyeSquintLeft", 0.5F * smile},
                                            {"eyeSquintRight", 0.5F * smile},
                                            {"jawOpen", jaw},
                                            {"mouthPucker", pucker},
                                            {"browInnerUp", brow},
                                            {"browOuterUpLeft", 0.8F * brow},
                                            {"browOuterUpRight", 0.8F * brow}})));
      frame->sequence = static_cast<std::uint64_t>(index);
      frame->media_time_ns = std::int64_t{index} * 33'333'333;
      return frame;
    });
    const auto basis = TakeBasis::open(file);
    const auto vertex = [&](const char* place) { return animate::find_vertex(*basis, place); };
    const mesh::Vertices rest = finest_of(actor.shape(expression_of(model, {})));
    const mesh::Vertices smiling = finest_of(actor.shape(expression_of(model, {{"mouthSmileLeft", 0.8F},
                                                                               {"mouthSmileRight", 0.8F},
                                                                               {"cheekSquintLeft", 0.5F},
                                                                               {"cheekSquintRight", 0.5F}})));
    const mesh::Vertices open = finest_of(actor.shape(expression_of(model, {{"jawOpen", 0.6F}})));
    const std::int32_t left = vertex("mouth-left");
    const std::int32_t right = vertex("mouth-right");
    const std::int32_t lip = vertex("lip-lower");
    const auto target = [](std::int32_t at, const mesh::Vertices& where) {
      return ControlTarget{at, ControlTarget::Space::Head, where.col(at)};
    };
    struct Case {
      const char* name;
      std::vector<ControlTarget> targets;
    };
    const std::vector<Case> cases{
        {"symmetric smile, 3 points", {target(left, smiling), target(right, smiling), target(lip, smiling)}},
        {"asymmetric smile, 3 points", {target(left, smiling), target(right, rest), target(lip, rest)}},
        {"lower lip alone of 3 points", {target(left, rest), target(right, rest), target(lip, open)}},
        {"lower lip, 1 point", {target(lip, open)}}};
    // The mouth's region, fixed: everything below the nose's tip, with a soft edge.
    const float edge_mm = rest(1, vertex("nose"));
    Eigen::VectorXf mask(basis->control_count());
    for (Eigen::Index c = 0; c < mask.size(); ++c) {
      mask[c] = 1 / (1 + std::exp((basis->coarse_mean()[3 * c + 1] - edge_mm + 4) / 3));
    }
    Sheet sheet(static_cast<int>(cases.size()), 2);
    for (std::size_t k = 0; k < cases.size(); ++k) {
      std::vector<std::int32_t> vertices;
      for (const ControlTarget& one : cases[k].targets) {
        vertices.push_back(one.vertex);
      }
      const RegionPca pca(basis, vertices, mask);
      const mesh::MeshFrame likely = pca.solve(cases[k].targets);
      const float pca_miss = worst_miss(likely, cases[k].targets);
      FaceIk ik(basis, {.whole = false, .beyond = true, .sharp_folds = true});
      Pose pose;
      const auto outcomes = ik.solve(cases[k].targets, pose);
      mesh::MeshFrame frame = animate::blank_frame(*basis);
      animate::blend(*basis, pose, frame);
      float nearest = 0;
      for (const auto& outcome : outcomes) {
        nearest = std::max(nearest, outcome.nearest_mm);
      }
      const float ik_miss = worst_miss(frame, cases[k].targets);
      fmt::print("{:>5} {:<34} {:<8} {:>9.3f} {:>18.3f}\n", seed, cases[k].name, "PCA", pca_miss,
                 pca.nearest_mm());
      fmt::print("{:>5} {:<34} {:<8} {:>9.3f} {:>18.3f}\n", seed, cases[k].name, "FaceIK", ik_miss, nearest);
      const int column = static_cast<int>(k);
      sheet.put(column, 0, draw(likely), fmt::format("PCA of the mouth: {}", cases[k].name));
      sheet.put(column, 1, draw(frame), fmt::format("FaceIK: {}", cases[k].name));
    }
    if (trial == 0) {
      sheet.write(std::filesystem::path(options.folder) / "animate-regions.png");
    }
  }
}

/// Frames of a take, spread over its time.
void run_sheet(const Options& options) {
  take::TakeReader reader(options.take);
  constexpr int kColumns = 8;
  constexpr int kRows = 5;
  Sheet sheet(kColumns, kRows);
  for (int cell = 0; cell < kColumns * kRows; ++cell) {
    const std::int64_t index = cell * (reader.frame_count() - 1) / (kColumns * kRows - 1);
    const auto frame = reader.frame(index);
    if (mesh::has_mesh(*frame)) {
      sheet.put(cell % kColumns, cell / kColumns, draw(*frame),
                fmt::format("{:.2f} s", static_cast<double>(frame->media_time_ns) * 1e-9));
    }
  }
  sheet.write(std::filesystem::path(options.folder) / "sheet.png");
}

}  // namespace
}  // namespace facet

int main(int argc, char** argv) {
  using namespace facet;
  Options options;
  CLI::App app{"Posing and animating takes: times and pictures"};
  app.require_subcommand(1);
  const auto with_folder = [&](CLI::App* command) {
    command->add_option("--model", options.model, "Face model")->capture_default_str();
    command->add_option("-o,--output", options.folder, "Folder for takes and pictures")
        ->capture_default_str();
    command->add_option("--seed", options.seed, "Of the virtual actor; pictures use three from it on")
        ->capture_default_str();
    return command;
  };
  CLI::App* time = with_folder(app.add_subcommand("time", "Basis, graph and FaceIK per event"));
  time->add_option("--take", options.take, "Measure this take instead of a virtual actor's");
  time->add_option("--frames", options.frames, "Of the take")
      ->capture_default_str()
      ->check(CLI::Range(30, 1'000'000));
  time->add_option("--vertices", options.vertices, "Of the finest level, at most")->capture_default_str();
  time->add_option("--controls", options.controls, "Control points")
      ->capture_default_str()
      ->check(CLI::Range(1, 64));
  time->add_option("--events", options.events, "Drag events")
      ->capture_default_str()
      ->check(CLI::Range(20, 100'000));
  time->callback([&] { run_time(options); });
  with_folder(app.add_subcommand("folds", "Folds averaged and re-evaluated"))->callback([&] {
    run_folds(options);
  });
  with_folder(app.add_subcommand("regions", "FaceIK beside PCA of fixed regions"))->callback([&] {
    run_regions(options);
  });
  CLI::App* sheet = with_folder(app.add_subcommand("sheet", "Forty frames of a take"));
  sheet->add_option("--take", options.take, "Take")->required();
  sheet->callback([&] { run_sheet(options); });
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error);
  } catch (const std::exception& error) {
    fmt::print(stderr, "animate_bench: {}\n", error.what());
    return 1;
  }
  return 0;
}
