// template_bench: fits the template to the virtual booth's performance and follows the skin through it; tells
// how far it is from the truth. Depth is the truth's with noise, so that nothing but fit, flow and tracking
// is judged, or with --stereo what spacetime stereo makes of the cameras' pictures.
//
//   build/release/bench/template_bench --seed 5 --meshes 60 --sheet build/template.png

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <span>
#include <string>
#include <vector>

#include "booth/booth_shading.hpp"
#include "capture/depth_map.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "fit/fine_surface.hpp"
#include "fit/first_shape.hpp"
#include "fit/skin_tracker.hpp"
#include "fit/template_mesh.hpp"
#include "gpu/context.hpp"
#include "render/renderer.hpp"
#include "simulation/virtual_booth.hpp"
#include "template_footage.hpp"
#include "template_measures.hpp"

namespace {

using namespace facet;
using bench::find_folded;
using bench::Follower;
using bench::Spread;
using bench::SurfaceError;
using Clock = std::chrono::steady_clock;

double ms_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

/// The mesh as seen by a camera, with a heat of its vertices; marked triangles are red.
render::Picture draw(const mesh::Triangles& triangles, const mesh::Vertices& vertices_mm,
                     const std::vector<float>* heat, const std::vector<std::uint8_t>* marked,
                     const capture::Lens& lens) {
  const Eigen::Isometry3f camera_from_rig = lens.camera_from_rig.cast<float>();
  const mesh::Vertices seen =
      (camera_from_rig.linear() * vertices_mm).colwise() + camera_from_rig.translation();
  const render::Raycaster caster(seen, triangles);
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(seen, triangles, normals);
  const CameraIntrinsics camera{static_cast<float>(lens.fx_px),
                                static_cast<float>(lens.fy_px),
                                static_cast<float>(lens.cx_px),
                                static_cast<float>(lens.cy_px),
                                lens.width_px,
                                lens.height_px};
  return render::render_surface(
      caster, camera,
      [&](std::int32_t triangle, const Eigen::Vector2f& at) -> Eigen::Vector3f {
        const Eigen::Vector3f normal = render::interpolate(triangles, triangle, at, normals).normalized();
        const float shade = 0.1F + 0.8F * std::max(0.0F, normal.dot(Eigen::Vector3f(-0.7F, -0.35F, -0.62F)));
        if (marked != nullptr && (*marked)[static_cast<std::size_t>(triangle)] != 0) {
          return {1, 0, 0};
        }
        if (heat == nullptr) {
          return Eigen::Vector3f::Constant(shade);
        }
        float value = 0;
        const std::array<float, 3> weights{1 - at.x() - at.y(), at.x(), at.y()};
        for (int i = 0; i < 3; ++i) {
          value += weights[static_cast<std::size_t>(i)] *
                   (*heat)[static_cast<std::size_t>(triangles(i, triangle))];
        }
        const auto colour = render::heat_colour(value);
        return (0.4F + 0.6F * shade) * Eigen::Vector3f(render::srgb8_to_linear(colour[0]),
                                                       render::srgb8_to_linear(colour[1]),
                                                       render::srgb8_to_linear(colour[2]));
      },
      render::plain_picture(lens.width_px, lens.height_px, {20, 20, 20}), 2);
}

/// A part of a lens's picture, drawn larger.
capture::Lens enlarged(capture::Lens lens, double x, double y, int width_px, int height_px, double factor) {
  lens.distortion = {};
  lens.fx_px *= factor;
  lens.fy_px *= factor;
  lens.cx_px = (lens.cx_px - x) * factor;
  lens.cy_px = (lens.cy_px - y) * factor;
  lens.width_px = static_cast<int>(width_px * factor);
  lens.height_px = static_cast<int>(height_px * factor);
  return lens;
}

/// What the command line says.
struct Options {
  std::string model_file = "assets/default.facemodel";
  std::string sheet;
  std::string cache;
  std::vector<int> sheet_at;
  fit::FineOptions fine;
  simulation::VirtualBoothConfig booth;
  int meshes = 30;
  double noise_mm = 0.1;
  bool no_flow = false;
  int still = 1'000'000;
  std::vector<int> gap = {1'000'000, 0};
  std::uint64_t stranger = 0;
  bool all_cameras = false;
  bool knows_light = true;
  bool with_stereo = false;
  bool with_between = false;
  bool with_shading = false;
  refine::RefinerConfig shading = booth::booth_refinement();
  std::uint64_t first_slot = 150;
  fit::SkinTrackerOptions tracking;
  std::int32_t vertices = 18'000;

  Options() {
    fine.sweeps = 0;
    booth.seed = 5;
  }
};

void add_options(CLI::App& app, Options& given) {
  fit::FitOptions& fit = given.tracking.fit;
  app.add_option("--model", given.model_file, "Face model");
  app.add_option("--seed", given.booth.seed, "Of booth and actor");
  app.add_option("--meshes", given.meshes, "20 a second");
  app.add_option("--vertices", given.vertices, "Of the template, at most");
  app.add_option("--samples", given.booth.samples, "Rays a pixel");
  app.add_option("--head-motion", given.booth.head_motion, "Share of the performance's");
  app.add_flag("--stereo", given.with_stereo, "Depth from the cameras' pictures");
  app.add_flag("--between", given.with_between,
               "The slots with stripes, too: a mesh between those of blank slots");
  app.add_option("--first-slot", given.first_slot, "A multiple of 3; the face is at rest before 150");
  app.add_option("--depth-noise", given.noise_mm, "mm");
  app.add_option("--alpha", fit.alpha);
  app.add_option("--beta", fit.beta);
  app.add_option("--steps", fit.steps);
  app.add_option("--model-steps", fit.model_steps, "Over pose and expressions before each fit");
  app.add_flag("!--no-unfold", fit.unfolds, "Folded triangles are left");
  app.add_option("--reference-sigma", given.tracking.reference_sigma_px, "px");
  app.add_option("--sigma-s", fit.sigma_s_mm, "Tukey's, of depth, mm");
  app.add_option("--gamma", fit.gamma, "Of the temporal term");
  app.add_option("--sigma-t", fit.sigma_t_mm, "mm");
  app.add_option("--still", given.still, "Meshes from this one on see its slot again, with other noise");
  app.add_option("--gap", given.gap, "First mesh that is left out, and how many")->expected(2);
  app.add_option("--stranger", given.stranger, "Seed of somebody else's face, seen once at the gap's end");
  app.add_option("--cg", fit.cg_iterations);
  app.add_flag("--no-flow", given.no_flow, "Depth alone");
  app.add_flag("--all-cameras", given.all_cameras, "Flow in the monochrome cameras' blank pictures, too");
  app.add_flag("!--no-light", given.knows_light, "The projectors' light and its shadows are not known");
  app.add_flag("!--no-redraw", given.tracking.redraws,
               "The picture before is not drawn again where the mesh is found");
  app.add_flag("!--no-reference", given.tracking.uses_reference,
               "Flow from picture to picture alone, as in the paper");
  app.add_flag("!--no-expressions", fit.knows_expressions, "E_r knows the pose alone");
  app.add_flag("!--fixed-rest", fit.turns_with_the_head, "E_r as in the paper");
  app.add_option("--fine", given.fine.sweeps, "Sweeps below the template; 0: none");
  app.add_option("--fine-smoothness", given.fine.smoothness);
  app.add_flag("--shading", given.with_shading, "Shading on top of the fine levels");
  app.add_option("--shading-prior", given.shading.weights.displacement_hierarchy,
                 "w4: towards the depth maps");
  app.add_option("--shading-smooth", given.shading.weights.displacement_smooth, "w3");
  app.add_option("--shading-steps", given.shading.gauss_newton_steps);
  app.add_option("--shading-robust", given.shading.robust_scale);
  app.add_option("--shading-albedo-frames", given.shading.albedo_frames);
  app.add_option("--shading-albedo-smooth", given.shading.weights.albedo_smooth, "w2");
  app.add_option("--cache", given.cache,
                 "Folder that keeps what was rendered; to be emptied when booth or face model change");
  app.add_option("--sheet", given.sheet, "PNG: picture, template, error of surface and of drift");
  app.add_option("--sheet-at", given.sheet_at,
                 "Meshes of which a sheet is made, their number before its name's end");
}

/// What is known and seen of one mesh's slot.
struct Moment {
  int mesh = 0;
  bool judged = false;  ///< one of the meshes whose surface is measured against the truth
  std::uint64_t slot = 0;
  std::mt19937_64 random;
  simulation::TruthMesh truth;
  std::vector<capture::DepthMap> maps;  ///< [pair_count]
  std::vector<Frame> pictures;          ///< of the cameras that flow is found in
};

/// The levels below the template, with shading on top where it is asked for, and how far they are from the
/// truth.
class FineLevels {
 public:
  FineLevels(const Options& options, const face::FaceModel& model,
             const std::shared_ptr<const fit::TemplateMesh>& surface, const capture::Rig& rig)
      : surface_(surface), fine_(model.control, surface, options.fine) {
    fmt::print("fine surface: {} vertices, {} triangles\n", fine_.hierarchy()->finest().vertex_count,
               triangles().cols());
    if (options.with_shading) {
      shade_ = std::make_unique<booth::BoothShading>("auto", rig, options.shading);
      shade_->begin(*fine_.hierarchy(), *surface, model);
    }
  }

  /// skin: [truth vertex_count] of the booth
  void add(const Moment& moment, const Eigen::VectorXf& skin, const mesh::Vertices& template_mm) {
    const auto begun = Clock::now();
    fine_.fit(moment.maps, template_mm, displacements_mm_, confidence_);
    ms_.push_back(ms_since(begun));
    mesh::rebuild_finest(*fine_.hierarchy(), template_mm, displacements_mm_, vertices_mm_, normals_);
    const auto seen = [this](std::size_t v) { return confidence_[v] > 0.2F; };
    if (moment.judged) {
      template_error_.add(moment.truth, skin, surface_->triangles, template_mm, seen);
      fine_error_.add(moment.truth, skin, triangles(), vertices_mm_, seen);
    }
    if (shade_ != nullptr) {
      add_shading(moment, template_mm, seen);
      if (moment.judged) {
        shaded_error_.add(moment.truth, skin, triangles(), vertices_mm_, seen);
      }
    }
    folded_ += find_folded(triangles(), vertices_mm_, seen, folded_triangles_);
  }

  void print() const {
    for (const auto& [name, error] :
         {std::pair<const char*, const SurfaceError&>("template", template_error_),
          {"fine", fine_error_},
          {"shaded", shaded_error_}}) {
      if (error.distances_mm.empty()) {
        continue;
      }
      const Spread distance(error.distances_mm);
      const Spread angle(error.angles_deg);
      fmt::print(
          "{}: from the true skin mean {:.4f} median {:.4f} p95 {:.4f} mm, normals mean {:.2f} median {:.2f} "
          "p95 "
          "{:.2f} degrees\n",
          name, distance.mean(), distance.at(0.5), distance.at(0.95), angle.mean(), angle.at(0.5),
          angle.at(0.95));
    }
    fmt::print("fine: folded {} in all; {:.0f} ms a mesh\n", folded_, Spread(ms_).mean());
    if (shade_ != nullptr) {
      fmt::print("shading: {:.0f} ms a mesh; added as it comes {} folded in all, {} turned over or nearly\n",
                 Spread(shade_ms_).mean(), shading_folded_, shading_turned_);
    }
  }

  const mesh::Triangles& triangles() const { return fine_.hierarchy()->finest().triangles; }
  const mesh::Vertices& vertices_mm() const { return vertices_mm_; }
  const std::vector<std::uint8_t>& folded_triangles() const { return folded_triangles_; }

 private:
  /// Turns the finest mesh into the shaded one.
  void add_shading(const Moment& moment, const mesh::Vertices& template_mm,
                   const std::function<bool(std::size_t)>& seen) {
    const auto begun = Clock::now();
    const std::string missing = shade_->refine(moment.pictures, template_mm, displacements_mm_, shading_mm_);
    shading_turned_ += fine_.add(template_mm, displacements_mm_, shading_mm_, shaded_mm_);
    shade_ms_.push_back(ms_since(begun));
    // As it would be if nothing were taken back.
    for (std::size_t v = 0; v < shading_mm_.size(); ++v) {
      shading_mm_[v] += displacements_mm_[v];
    }
    mesh::rebuild_finest(*fine_.hierarchy(), template_mm, shading_mm_, vertices_mm_, normals_);
    shading_folded_ += find_folded(triangles(), vertices_mm_, seen, folded_triangles_);
    if (!missing.empty()) {
      fmt::print("mesh {:3d}: {}\n", moment.mesh, missing);
    }
    mesh::rebuild_finest(*fine_.hierarchy(), template_mm, shaded_mm_, vertices_mm_, normals_);
  }

  std::shared_ptr<const fit::TemplateMesh> surface_;
  fit::FineSurface fine_;
  std::unique_ptr<booth::BoothShading> shade_;
  std::vector<float> displacements_mm_;
  std::vector<float> confidence_;
  std::vector<float> shading_mm_;
  std::vector<float> shaded_mm_;
  mesh::Vertices vertices_mm_;
  Eigen::Matrix3Xf normals_;
  std::vector<std::uint8_t> folded_triangles_;
  SurfaceError template_error_;
  SurfaceError fine_error_;
  SurfaceError shaded_error_;
  std::vector<double> ms_;
  std::vector<double> shade_ms_;
  int folded_ = 0;
  int shading_folded_ = 0;
  int shading_turned_ = 0;
};

std::shared_ptr<const fit::TemplateMesh> make_surface(const face::FaceModel& model, std::int32_t vertices) {
  auto surface = std::make_shared<const fit::TemplateMesh>(fit::make_template(model, vertices));
  fmt::print("template: {} vertices, {} triangles\n", surface->vertex_count(), surface->triangles.cols());
  return surface;
}

std::vector<std::size_t> flow_cameras(const capture::Rig& rig, bool all_cameras) {
  std::vector<std::size_t> cameras;
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    if (rig.cameras[i].colour || all_cameras) {
      cameras.push_back(i);
    }
  }
  return cameras;
}

std::vector<capture::Lens> lenses_of(const capture::Rig& rig, const std::vector<std::size_t>& cameras) {
  std::vector<capture::Lens> lenses;
  for (const std::size_t camera : cameras) {
    lenses.push_back(rig.cameras[camera].lens);
  }
  return lenses;
}

std::vector<capture::Lens> projectors_of(const capture::Rig& rig) {
  std::vector<capture::Lens> lenses;
  for (const capture::RigProjector& projector : rig.projectors) {
    lenses.push_back(projector.lens);
  }
  return lenses;
}

/// Follows the performance mesh by mesh and judges each mesh by the truth.
class Course {
 public:
  explicit Course(const Options& options)
      : options_(options),
        model_(face::FaceModel::load(options.model_file)),
        booth_(&model_, options.booth),
        rig_(booth_.rig()),
        surface_(make_surface(model_, options.vertices)),
        cameras_(flow_cameras(rig_, options.all_cameras)),
        tracker_(surface_, lenses_of(rig_, cameras_),
                 options.knows_light ? projectors_of(rig_) : std::vector<capture::Lens>(), options.tracking),
        context_(options.with_stereo ? std::make_unique<gpu::Context>(gpu::ContextOptions()) : nullptr),
        depth_(context_ != nullptr ? std::make_unique<bench::StereoDepth>(*context_, booth_) : nullptr),
        footage_(booth_, options.cache),
        fine_(options.fine.sweeps > 0 ? std::make_unique<FineLevels>(options, model_, surface_, rig_)
                                      : nullptr),
        followers_(static_cast<std::size_t>(surface_->vertex_count())),
        distance_heat_(followers_.size()),
        drift_heat_(followers_.size()) {}

  void run() {
    for (int m = 0; m < options_.meshes; ++m) {
      if (m < options_.gap[0] || m >= options_.gap[0] + options_.gap[1]) {
        add(m);
      }
    }
    print();
  }

 private:
  bool is_last(int m) const { return m + 1 == options_.meshes; }

  std::vector<capture::DepthMap> maps_of(std::uint64_t slot, const simulation::TruthMesh& truth,
                                         std::mt19937_64& random) const {
    return depth_ != nullptr ? footage_.stereo(slot, *depth_) : true_maps(truth, random);
  }

  std::vector<capture::DepthMap> true_maps(const simulation::TruthMesh& truth,
                                           std::mt19937_64& random) const {
    std::vector<capture::DepthMap> maps;
    for (const capture::StereoPair& pair : rig_.pairs) {
      maps.push_back(bench::depth_of(truth, rig_.cameras[pair.left].lens, options_.noise_mm, random));
    }
    return maps;
  }

  Moment moment_of(int m) const {
    Moment moment;
    moment.mesh = m;
    moment.judged = m % 10 == 0 || is_last(m);
    moment.slot = options_.first_slot + static_cast<std::uint64_t>(3 * std::min(m, options_.still) + 2);
    moment.random.seed(options_.booth.seed * 100'000 + options_.first_slot +
                       static_cast<std::uint64_t>(3 * m));
    moment.truth = footage_.truth(moment.slot);
    moment.maps = maps_of(moment.slot, moment.truth, moment.random);
    for (const std::size_t camera : cameras_) {
      moment.pictures.push_back(footage_.picture(moment.slot, camera));
      if (m > options_.still) {
        bench::add_noise(moment.pictures.back(), moment.random);
      }
    }
    return moment;
  }

  /// By landmarks as a detector finds them: 1 mm of noise.
  fit::Placement placed_by_landmarks(const simulation::TruthMesh& face, std::mt19937_64& random) const {
    std::vector<fit::Correspondence> correspondences;
    std::normal_distribution<double> noise(0, 1);
    for (const face::LandmarkAnchor& anchor : model_.landmarks) {
      if (anchor.weights[0] + anchor.weights[1] + anchor.weights[2] > 0.5F && correspondences.size() < 468) {
        const Eigen::Vector3d at =
            face::FaceModel::anchor_point(anchor, face.vertices_mm.leftCols(model_.vertex_count()))
                .cast<double>();
        correspondences.push_back(
            {anchor, at + Eigen::Vector3d(noise(random), noise(random), noise(random))});
      }
    }
    fit::Placement placed =
        fit::place(*surface_, fit::find_first_shape(model_, correspondences), correspondences);
    fmt::print("placed by {} landmarks, rms {:.2f} mm\n", correspondences.size(), placed.rms_mm);
    return placed;
  }

  void add(int m) {
    Moment moment = moment_of(m);
    const render::Raycaster caster(moment.truth.vertices_mm, moment.truth.triangles);
    const fit::TemplateFitReport report = track(moment, caster);
    note(m, report);
    const mesh::Vertices& now_mm = tracker_.vertices_mm();
    std::vector<double> distances;
    std::vector<double> drifts;
    judge(moment.truth, caster, distances, drifts);
    if (options_.with_between && tracker_.follows() && m < options_.still) {
      judge_between(moment);
    }
    motion_.add(followers_, moment.truth, now_mm);
    const int folded = find_folded(
        surface_->triangles, now_mm, [this](std::size_t v) { return followers_[v].triangle >= 0; },
        folded_triangles_);
    folded_ever_ += folded;
    if (fine_ != nullptr) {
      fine_->add(moment, booth_.skin(), now_mm);
    }
    all_distances_.insert(all_distances_.end(), distances.begin(), distances.end());
    const Spread distance(std::move(distances));
    const Spread drift(std::move(drifts));
    worst_drift_ = std::max(worst_drift_, drift.mean());
    worst_drift_95_ = std::max(worst_drift_95_, drift.at(0.95));
    if (m < 3 || m % 10 == 9 || is_last(m) || folded > 0) {
      fmt::print(
          "mesh {:3d}: distance mean {:.3f} p95 {:.3f} mm, drift mean {:.3f} p95 {:.3f} max {:.1f} mm, "
          "folded {}; {} after {}, rms {:.3f} mm {:.2f} px, seen {:.0f} %, followed {:.0f} %\n",
          m, distance.mean(), distance.at(0.95), drift.mean(), drift.at(0.95), drift.at(1), folded,
          to_string(report.outcome), report.steps, report.surface_rms_mm, report.motion_rms_px,
          100 * report.seen, 100 * report.followed);
    }
    if (!options_.sheet.empty() &&
        (is_last(m) || std::count(options_.sheet_at.begin(), options_.sheet_at.end(), m) > 0)) {
      write_sheet(moment);
    }
  }

  /// The template on the mesh's slot, in whichever way is its turn.
  fit::TemplateFitReport track(Moment& moment, const render::Raycaster& caster) {
    const std::vector<Frame> none(moment.pictures.size());
    const std::span<const Frame> pictures(options_.no_flow ? none.data() : moment.pictures.data(),
                                          moment.pictures.size());
    const auto asked = Clock::now();
    if (moment.mesh == 0) {
      const fit::Placement placed = placed_by_landmarks(moment.truth, moment.random);
      const fit::TemplateFitReport report = tracker_.start(placed, moment.maps, pictures);
      fmt::print("fit: {} after {} steps, {:.0f} ms, rms {:.3f} mm, {:.0f} % seen\n",
                 to_string(report.outcome), report.steps, ms_since(asked), report.surface_rms_mm,
                 100 * report.seen);
      choose_followers(moment.truth, caster);
      return report;
    }
    const fit::TemplateFitReport report = moment.mesh == options_.gap[0] + options_.gap[1]
                                              ? track_after_gap(moment, pictures)
                                              : tracker_.follow(moment.maps, pictures);
    follow_ms_.push_back(ms_since(asked));
    return report;
  }

  fit::TemplateFitReport track_after_gap(Moment& moment, std::span<const Frame> pictures) {
    const fit::TemplateFitReport report = tracker_.follow(moment.maps, pictures);
    fmt::print("mesh {:3d}: after the gap, from where it was: {}\n", moment.mesh,
               report.lost ? "lost, " + report.lost_because : "not noticed");
    if (options_.stranger != 0) {
      show_stranger(moment);
    }
    return tracker_.find_again(placed_by_landmarks(moment.truth, moment.random), moment.maps, pictures);
  }

  /// Somebody else in the booth, who is not to be taken for the person who is followed.
  void show_stranger(Moment& moment) {
    simulation::VirtualBoothConfig config = options_.booth;
    config.actor_seed = options_.stranger;
    const simulation::VirtualBooth other(&model_, config);
    const bench::Footage footage(other, options_.cache);
    const simulation::TruthMesh truth = footage.truth(moment.slot);
    const std::vector<capture::DepthMap> maps = true_maps(truth, moment.random);
    std::vector<Frame> pictures;
    for (const std::size_t camera : cameras_) {
      pictures.push_back(footage.picture(moment.slot, camera));
    }
    const fit::TemplateFitReport judged =
        tracker_.find_again(placed_by_landmarks(truth, moment.random), maps, pictures);
    fmt::print("mesh {:3d}: somebody else: {}, shape {:.2f} mm, rms {:.2f} mm, flow trust {:.2f}\n",
               moment.mesh, judged.lost ? "lost, " + judged.lost_because : "not noticed", judged.shape_rms_mm,
               judged.surface_rms_mm, judged.flow_trust);
  }

  /// Vertices that lie on the true skin once the template is fitted are to stay on its points.
  void choose_followers(const simulation::TruthMesh& truth, const render::Raycaster& caster) {
    for (std::int32_t v = 0; v < surface_->vertex_count(); ++v) {
      const auto vertex = static_cast<std::size_t>(v);
      const auto hit = caster.closest_point(tracker_.vertices_mm().col(v), 2);
      if (surface_->is_skin[vertex] != 0 && tracker_.depth_weight()[vertex] > 0.2F && hit.triangle >= 0 &&
          booth_.skin()[truth.triangles(0, hit.triangle)] > 0.9F) {
        followers_[vertex] = {hit.triangle, hit.barycentric};
      }
    }
  }

  void note(int m, const fit::TemplateFitReport& report) {
    if (report.lost) {
      fmt::print("mesh {:3d}: lost, {}\n", m, report.lost_because);
    }
    worst_rejected_ = std::max(worst_rejected_, report.rejected);
    worst_rms_ = std::max(worst_rms_, report.surface_rms_mm);
    worst_shape_ = std::max(worst_shape_, m > 0 ? report.shape_rms_mm : 0);
    if (m > 0) {
      least_trust_ = std::min(least_trust_, report.flow_trust);
    }
    least_seen_ = std::min(least_seen_, report.seen);
  }

  /// How far each follower is from the true surface, and from the point of the skin that it follows, mm.
  void judge(const simulation::TruthMesh& truth, const render::Raycaster& caster,
             std::vector<double>& distances, std::vector<double>& drifts) {
    for (std::size_t v = 0; v < followers_.size(); ++v) {
      if (followers_[v].triangle < 0) {
        continue;
      }
      const Eigen::Vector3f at = tracker_.vertices_mm().col(static_cast<Eigen::Index>(v));
      const auto hit = caster.closest_point(at, 30);
      distances.push_back(hit.triangle >= 0 ? static_cast<double>(hit.distance_mm) : 30.0);
      distance_heat_[v] = static_cast<float>(distances.back()) / 1.0F;
      const Eigen::Vector3f true_mm = render::interpolate(truth.triangles, followers_[v].triangle,
                                                          followers_[v].barycentric, truth.vertices_mm);
      drifts.push_back(static_cast<double>((true_mm - at).norm()));
      drift_heat_[v] = static_cast<float>(drifts.back()) / 3.0F;
    }
  }

  /// The two slots with stripes before the mesh's.
  void judge_between(Moment& moment) {
    const mesh::Vertices& now_mm = tracker_.vertices_mm();
    for (int k = 1; k <= 2; ++k) {
      const std::uint64_t slot = moment.slot - 3 + static_cast<std::uint64_t>(k);
      const simulation::TruthMesh truth = footage_.truth(slot);
      const auto settling = Clock::now();
      mesh::Vertices settled_mm;
      Eigen::VectorXd expression;
      tracker_.between(k / 3.0, maps_of(slot, truth, moment.random), settled_mm, expression);
      between_.ms.push_back(ms_since(settling));
      const mesh::Vertices way_mm =
          motion_.last_mm() + static_cast<float>(k) / 3 * (now_mm - motion_.last_mm());
      const render::Raycaster caster(truth.vertices_mm, truth.triangles);
      between_.add(false, followers_, truth, caster, way_mm);
      between_.add(true, followers_, truth, caster, settled_mm);
    }
  }

  /// The face in the last colour camera's picture, twice as large, beside the meshes.
  void write_sheet(const Moment& moment) const {
    constexpr int kPart_px = 300;
    const mesh::Vertices& now_mm = tracker_.vertices_mm();
    const capture::Lens& whole = rig_.cameras[cameras_.back()].lens;
    mesh::Vertices counted_mm(3, 0);
    for (std::size_t v = 0; v < followers_.size(); ++v) {
      if (followers_[v].triangle >= 0) {
        counted_mm.conservativeResize(3, counted_mm.cols() + 1);
        counted_mm.rightCols(1) = now_mm.col(static_cast<Eigen::Index>(v));
      }
    }
    const Eigen::Vector2d middle =
        whole.project(counted_mm.rowwise().mean().cast<double>()).value_or(Eigen::Vector2d(320, 240));
    const double x = std::round(middle.x() - kPart_px / 2);
    const double y = std::round(middle.y() - kPart_px / 2);
    const capture::Lens lens = enlarged(whole, x, y, kPart_px, kPart_px, 2);
    const render::Picture picture =
        render::resize(render::crop(render::to_picture(moment.pictures.back()), static_cast<int>(x),
                                    static_cast<int>(y), kPart_px, kPart_px),
                       lens.width_px, lens.height_px);
    std::vector<render::Picture> parts = {
        picture, draw(surface_->triangles, now_mm, nullptr, &folded_triangles_, lens),
        draw(surface_->triangles, now_mm, &distance_heat_, nullptr, lens),
        draw(surface_->triangles, now_mm, &drift_heat_, &folded_triangles_, lens)};
    if (fine_ != nullptr) {
      parts.push_back(
          draw(fine_->triangles(), fine_->vertices_mm(), nullptr, &fine_->folded_triangles(), lens));
      parts.push_back(draw(moment.truth.triangles, moment.truth.vertices_mm, nullptr, nullptr, lens));
    }
    const int columns = static_cast<int>(parts.size()) / 2;
    render::Picture out = render::plain_picture(columns * lens.width_px, 2 * lens.height_px, {0, 0, 0});
    for (int i = 0; i < static_cast<int>(parts.size()); ++i) {
      render::paste(out, parts[static_cast<std::size_t>(i)], i % columns * lens.width_px,
                    i / columns * lens.height_px);
    }
    std::filesystem::path file = options_.sheet;
    if (!is_last(moment.mesh)) {
      file.replace_filename(
          fmt::format("{}-{}{}", file.stem().string(), moment.mesh, file.extension().string()));
    }
    render::write_png(out, file);
  }

  void print() const {
    const Spread all(all_distances_);
    fmt::print(
        "all: distance mean {:.3f} p95 {:.3f} mm, folded {} in all; {:.0f} ms a mesh with {} cameras\n",
        all.mean(), all.at(0.95), folded_ever_, Spread(follow_ms_).mean(), cameras_.size());
    if (options_.with_between) {
      between_.print();
    }
    fmt::print(
        "worst drift mean {:.3f} p95 {:.3f} mm; second differences {:.4f} mm rms, lag {:.4f} meshes; seen >= "
        "{:.2f}, "
        "rejected <= {:.3f}, rms <= {:.2f} mm, shape <= {:.2f} mm, flow trust >= {:.2f}\n",
        worst_drift_, worst_drift_95_, motion_.jitter_mm(), motion_.lag(), least_seen_, worst_rejected_,
        worst_rms_, worst_shape_, least_trust_);
    if (fine_ != nullptr) {
      fine_->print();
    }
  }

  const Options& options_;
  face::FaceModel model_;
  simulation::VirtualBooth booth_;
  const capture::Rig& rig_;
  std::shared_ptr<const fit::TemplateMesh> surface_;
  std::vector<std::size_t> cameras_;  ///< that flow is found in
  fit::SkinTracker tracker_;
  std::unique_ptr<gpu::Context> context_;
  std::unique_ptr<bench::StereoDepth> depth_;  ///< null: depth is the truth's
  bench::Footage footage_;
  std::unique_ptr<FineLevels> fine_;
  std::vector<Follower> followers_;  ///< [template vertex_count]
  std::vector<float> distance_heat_;
  std::vector<float> drift_heat_;
  std::vector<std::uint8_t> folded_triangles_;
  bench::Motion motion_;
  bench::BetweenError between_;
  std::vector<double> follow_ms_;
  std::vector<double> all_distances_;
  int folded_ever_ = 0;
  double worst_rejected_ = 0;
  double worst_rms_ = 0;
  double worst_shape_ = 0;
  double least_trust_ = 1;
  double least_seen_ = 1;
  double worst_drift_ = 0;
  double worst_drift_95_ = 0;
};

int run(int argc, char** argv) {
  CLI::App app{"Fits and tracks the template in the virtual booth and measures it against the truth."};
  Options options;
  add_options(app, options);
  CLI11_PARSE(app, argc, argv);
  Course(options).run();
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const Error& error) {
    fmt::print(stderr, "template_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
