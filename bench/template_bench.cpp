// template_bench: fits the template to the virtual booth's performance and follows the skin through it; tells
// how far it is from the truth. Depth is the truth's with noise, so that nothing but fit, flow and tracking
// is judged, or with --stereo what spacetime stereo makes of the cameras' pictures.
//
//   build/release/bench/template_bench --seed 5 --meshes 60 --sheet build/template.png

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>
#include <random>

#include "capture/depth_map.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "fit/optical_flow.hpp"
#include "fit/reference_picture.hpp"
#include "fit/template_fitter.hpp"
#include "fit/template_mesh.hpp"
#include "gpu/context.hpp"
#include "render/renderer.hpp"
#include "simulation/booth.hpp"
#include "stereo/stereo_matcher.hpp"

namespace {

using namespace facet;
using Clock = std::chrono::steady_clock;

double ms_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

struct Spread {
  explicit Spread(std::vector<double> values) : sorted(std::move(values)) {
    std::sort(sorted.begin(), sorted.end());
  }
  double mean() const {
    return sorted.empty()
               ? 0
               : std::accumulate(sorted.begin(), sorted.end(), 0.0) / static_cast<double>(sorted.size());
  }
  double at(double share) const {
    return sorted.empty() ? 0
                          : sorted[static_cast<std::size_t>(share * static_cast<double>(sorted.size() - 1))];
  }
  std::vector<double> sorted;
};

/// The truth as a perfect pair would give it, plus white noise.
capture::DepthMap depth_of(const simulation::TruthMesh& truth, capture::Lens lens, double noise_mm,
                           std::mt19937_64& random) {
  lens.distortion = {};
  const Eigen::Isometry3f camera_from_rig = lens.camera_from_rig.cast<float>();
  const mesh::Vertices seen =
      (camera_from_rig.linear() * truth.vertices_mm).colwise() + camera_from_rig.translation();
  const render::Raycaster caster(seen, truth.triangles);
  const CameraIntrinsics camera{static_cast<float>(lens.fx_px),
                                static_cast<float>(lens.fy_px),
                                static_cast<float>(lens.cx_px),
                                static_cast<float>(lens.cy_px),
                                lens.width_px,
                                lens.height_px};
  capture::DepthMap map;
  map.width_px = lens.width_px;
  map.height_px = lens.height_px;
  map.lens = lens;
  map.depth_mm = caster.cast(camera).depth_mm;
  map.confidence.resize(map.depth_mm.size());
  map.sigma_mm.resize(map.depth_mm.size());
  std::normal_distribution<double> noise(0, std::max(noise_mm, 1e-9));
  for (std::size_t i = 0; i < map.depth_mm.size(); ++i) {
    if (map.depth_mm[i] > 0) {
      map.depth_mm[i] += static_cast<float>(noise_mm > 0 ? noise(random) : 0);
      map.confidence[i] = 1;
      map.sigma_mm[i] = static_cast<float>(noise_mm);
    }
  }
  return map;
}

/// What stereo makes of a blank slot with two slots on either side.
class StereoDepth {
 public:
  StereoDepth(gpu::Context& context, const simulation::Booth& booth) : booth_(booth) {
    stereo::StereoOptions options;
    options.depths = {850, 1250};
    options.most_slots = kSlots;
    for (const capture::StereoPair& pair : booth.rig().pairs) {
      matchers_.push_back(std::make_unique<stereo::StereoMatcher>(context, booth.rig(), pair, options));
    }
  }
  std::vector<capture::DepthMap> at(std::uint64_t blank, double& ms) {
    std::vector<capture::DepthMap> result;
    std::vector<std::vector<stereo::StereoSlot>> slots(matchers_.size());
    for (int i = 0; i < kSlots; ++i) {
      const simulation::BoothSlot slot = booth_.slot(blank + static_cast<std::uint64_t>(i) - kSlots / 2);
      for (std::size_t p = 0; p < matchers_.size(); ++p) {
        const capture::StereoPair& pair = booth_.rig().pairs[p];
        slots[p].push_back({slot.frame(pair.left),
                            slot.frame(pair.right),
                            slot.shown().kind == capture::Shown::Kind::Stripes,
                            {}});
      }
    }
    const auto begun = Clock::now();
    for (std::size_t p = 0; p < matchers_.size(); ++p) {
      if (matchers_[p]->match(slots[p], maps_) != stereo::SolveOutcome::Done) {
        throw Error(ErrorKind::Internal, matchers_[p]->failure());
      }
      result.push_back(std::move(maps_[kSlots / 2]));
    }
    ms = ms_since(begun);
    return result;
  }

 private:
  static constexpr int kSlots = 5;
  const simulation::Booth& booth_;
  std::vector<std::unique_ptr<stereo::StereoMatcher>> matchers_;
  std::vector<capture::DepthMap> maps_;
};

struct Follower {
  std::int32_t triangle = -1;
  Eigen::Vector2f barycentric{0, 0};
};

/// The mesh as seen by a camera, with a heat of its vertices.
render::Picture draw(const fit::TemplateMesh& surface, const mesh::Vertices& vertices_mm,
                     const std::vector<float>* heat, const capture::Lens& lens,
                     const render::Picture& background) {
  const Eigen::Isometry3f camera_from_rig = lens.camera_from_rig.cast<float>();
  const mesh::Vertices seen =
      (camera_from_rig.linear() * vertices_mm).colwise() + camera_from_rig.translation();
  const render::Raycaster caster(seen, surface.triangles);
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(seen, surface.triangles, normals);
  const CameraIntrinsics camera{static_cast<float>(lens.fx_px),
                                static_cast<float>(lens.fy_px),
                                static_cast<float>(lens.cx_px),
                                static_cast<float>(lens.cy_px),
                                lens.width_px,
                                lens.height_px};
  return render::render_surface(
      caster, camera,
      [&](std::int32_t triangle, const Eigen::Vector2f& at) -> Eigen::Vector3f {
        const Eigen::Vector3f normal =
            render::interpolate(surface.triangles, triangle, at, normals).normalized();
        const float shade = 0.15F + 0.75F * std::max(0.0F, normal.dot(Eigen::Vector3f(-0.3F, -0.4F, -0.85F)));
        if (heat == nullptr) {
          return Eigen::Vector3f::Constant(shade);
        }
        float value = 0;
        const std::array<float, 3> weights{1 - at.x() - at.y(), at.x(), at.y()};
        for (int i = 0; i < 3; ++i) {
          value += weights[static_cast<std::size_t>(i)] *
                   (*heat)[static_cast<std::size_t>(surface.triangles(i, triangle))];
        }
        const auto colour = render::heat_colour(value);
        return (0.4F + 0.6F * shade) * Eigen::Vector3f(render::srgb8_to_linear(colour[0]),
                                                       render::srgb8_to_linear(colour[1]),
                                                       render::srgb8_to_linear(colour[2]));
      },
      background, 2);
}

int run(int argc, char** argv) {
  CLI::App app{"Fits and tracks the template in the virtual booth and measures it against the truth."};
  std::string model_file = "assets/default.facemodel";
  std::string sheet;
  simulation::BoothConfig config;
  config.seed = 5;
  int meshes = 30;
  double noise_mm = 0.1;
  bool no_flow = false;
  bool no_reference = false;
  bool all_cameras = false;
  bool with_stereo = false;
  std::uint64_t first_slot = 150;
  fit::FitOptions options;
  std::int32_t vertices = 18'000;
  app.add_option("--model", model_file, "Face model");
  app.add_option("--seed", config.seed, "Of booth and actor");
  app.add_option("--meshes", meshes, "20 a second");
  app.add_option("--vertices", vertices, "Of the template, at most");
  app.add_option("--samples", config.samples, "Rays a pixel");
  app.add_option("--head-motion", config.head_motion, "Share of the performance's");
  app.add_flag("--stereo", with_stereo, "Depth from the cameras' pictures");
  app.add_option("--first-slot", first_slot, "A multiple of 3; the face is at rest before 150");
  app.add_option("--depth-noise", noise_mm, "mm");
  app.add_option("--alpha", options.alpha);
  app.add_option("--beta", options.beta);
  app.add_option("--steps", options.steps);
  app.add_option("--cg", options.cg_iterations);
  app.add_flag("--no-flow", no_flow, "Depth alone");
  app.add_flag("--all-cameras", all_cameras, "Flow in the monochrome cameras' blank pictures, too");
  app.add_flag("--no-reference", no_reference, "Flow from picture to picture alone, as in the paper");
  app.add_flag("!--no-expressions", options.knows_expressions, "E_r knows the pose alone");
  app.add_flag("!--fixed-rest", options.turns_with_the_head, "E_r as in the paper");
  app.add_option("--sheet", sheet, "PNG: picture, template, error of surface and of drift");
  CLI11_PARSE(app, argc, argv);

  const face::FaceModel model = face::FaceModel::load(model_file);
  const simulation::Booth booth(&model, config);
  const capture::Rig& rig = booth.rig();
  const auto surface = std::make_shared<const fit::TemplateMesh>(fit::make_template(model, vertices));
  fit::TemplateFitter fitter(surface, options);
  fmt::print("template: {} vertices, {} triangles\n", surface->vertex_count(), surface->triangles.cols());
  std::vector<std::size_t> colour;
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    if (rig.cameras[i].colour || all_cameras) {
      colour.push_back(i);
    }
  }
  std::unique_ptr<gpu::Context> context;
  std::unique_ptr<StereoDepth> depth;
  std::vector<double> stereo_ms;
  if (with_stereo) {
    context = std::make_unique<gpu::Context>(gpu::ContextOptions());
    depth = std::make_unique<StereoDepth>(*context, booth);
  }
  std::mt19937_64 random(config.seed);
  std::vector<fit::OpticalFlow> flows(colour.size());
  std::vector<Frame> before(colour.size());
  std::vector<fit::ReferencePicture> references;
  mesh::Vertices control_mm;
  model.evaluate({}, {}, control_mm);
  mesh::Vertices now_mm;
  std::vector<Follower> followers(static_cast<std::size_t>(surface->vertex_count()));
  std::vector<double> fit_ms;
  std::vector<double> flow_ms;
  std::vector<float> distance_heat(followers.size());
  std::vector<float> drift_heat(followers.size());
  Eigen::Matrix3Xf normals;
  std::vector<double> all_distances;
  std::vector<std::uint8_t> measured(followers.size(), 0);
  for (int m = 0; m < meshes; ++m) {
    const simulation::BoothSlot slot = booth.slot(first_slot + static_cast<std::uint64_t>(3 * m + 2));
    const simulation::TruthMesh truth = slot.surface();
    std::vector<capture::DepthMap> maps;
    if (with_stereo) {
      maps = depth->at(slot.number(), stereo_ms.emplace_back());
    }
    for (const capture::StereoPair& pair : with_stereo ? std::vector<capture::StereoPair>() : rig.pairs) {
      maps.push_back(depth_of(truth, rig.cameras[pair.left].lens, noise_mm, random));
    }
    std::vector<Frame> pictures;
    for (const std::size_t camera : colour) {
      pictures.push_back(slot.frame(camera));
    }
    const render::Raycaster caster(truth.vertices_mm, truth.triangles);
    fit::FitReport report;
    if (m == 0) {
      // Landmarks as a detector finds them: 1 mm of noise.
      std::vector<fit::Correspondence> correspondences;
      std::normal_distribution<double> noise(0, 1);
      for (const face::LandmarkAnchor& anchor : model.landmarks) {
        if (anchor.weights[0] + anchor.weights[1] + anchor.weights[2] > 0.5F &&
            correspondences.size() < 468) {
          const Eigen::Vector3d at =
              face::FaceModel::anchor_point(anchor, truth.vertices_mm.leftCols(model.vertex_count()))
                  .cast<double>();
          correspondences.push_back(
              {anchor, at + Eigen::Vector3d(noise(random), noise(random), noise(random))});
        }
      }
      const fit::Placement placed = fit::place(*surface, control_mm, correspondences);
      fmt::print("placed by {} landmarks, rms {:.2f} mm\n", correspondences.size(), placed.rms_mm);
      now_mm = placed.rest.vertices_mm;
      fit::FitOptions start = options;
      start.steps = 30;
      start.cg_iterations = 200;
      fit::TemplateFitter first(surface, start);
      const auto begun = Clock::now();
      first.set_rest(placed.rest);
      report = first.fit(maps, now_mm);
      fmt::print("fit: {} after {} steps, {:.0f} ms, rms {:.3f} mm, {:.0f} % seen\n",
                 to_string(report.outcome), report.steps, ms_since(begun), report.surface_rms_mm,
                 100 * report.seen);
      fitter.set_rest({now_mm, placed.rest.expressions_mm});
      mesh::vertex_normals(now_mm, surface->triangles, normals);
      std::vector<std::uint8_t> visible;
      for (std::size_t k = 0; k < colour.size(); ++k) {
        const capture::Lens& lens = rig.cameras[colour[k]].lens;
        fit::find_visible(lens, now_mm, normals, surface->triangles, 4, 0, visible);
        references.emplace_back(lens, pictures[k], now_mm, surface->triangles, visible);
      }
      for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
        const auto vertex = static_cast<std::size_t>(v);
        const auto hit = caster.closest_point(now_mm.col(v), 2);
        if (surface->is_skin[vertex] != 0 && first.depth_weight()[vertex] > 0.2F && hit.triangle >= 0 &&
            booth.skin()[truth.triangles(0, hit.triangle)] > 0.9F) {
          followers[vertex] = {hit.triangle, hit.barycentric};
        }
      }
    } else {
      auto begun = Clock::now();
      std::vector<fit::Flow> found(colour.size());
      std::vector<fit::FlowView> views;
      for (std::size_t k = 0; k < colour.size() && !no_flow; ++k) {
        flows[k].find(before[k], pictures[k], found[k]);
        views.push_back({rig.cameras[colour[k]].lens, found[k].width_px, found[k].height_px, found[k].flow_px,
                         found[k].confidence});
      }
      flow_ms.push_back(ms_since(begun));
      begun = Clock::now();
      const mesh::Vertices before_mm = now_mm;
      report = fitter.track(maps, views, before_mm, now_mm);
      if (!no_reference) {
        mesh::vertex_normals(now_mm, surface->triangles, normals);
        std::vector<std::uint8_t> visible;
        std::vector<std::uint8_t> drawn;
        for (std::size_t k = 0; k < colour.size(); ++k) {
          fit::find_visible(views[k].lens, now_mm, normals, surface->triangles, 4, 0, visible);
          const Frame expected = references[k].draw(pictures[k], now_mm, visible, drawn);
          flows[k].find(expected, pictures[k], found[k]);
          for (std::size_t i = 0; i < drawn.size(); ++i) {
            found[k].confidence[i] *= static_cast<float>(drawn[i]);
          }
        }
        const mesh::Vertices drifted_mm = now_mm;
        report = fitter.track(maps, views, drifted_mm, now_mm);
      }
      fit_ms.push_back(ms_since(begun));
    }
    std::vector<double> distances;
    std::vector<double> drifts;
    for (std::size_t v = 0; v < followers.size(); ++v) {
      if (followers[v].triangle < 0) {
        continue;
      }
      const Eigen::Vector3f at = now_mm.col(static_cast<Eigen::Index>(v));
      const auto hit = caster.closest_point(at, 30);
      distances.push_back(hit.triangle >= 0 ? static_cast<double>(hit.distance_mm) : 30.0);
      distance_heat[v] = static_cast<float>(distances.back()) / 1.0F;
      const Eigen::Vector3f true_mm = render::interpolate(truth.triangles, followers[v].triangle,
                                                          followers[v].barycentric, truth.vertices_mm);
      drifts.push_back(static_cast<double>((true_mm - at).norm()));
      drift_heat[v] = static_cast<float>(drifts.back()) / 3.0F;
    }
    // Folded over: a triangle that looks the other way than the surface around it.
    mesh::vertex_normals(now_mm, surface->triangles, normals);
    int folded = 0;
    for (Eigen::Index t = 0; t < surface->triangles.cols(); ++t) {
      const auto corner = surface->triangles.col(t);
      const bool counted = followers[static_cast<std::size_t>(corner[0])].triangle >= 0 &&
                           followers[static_cast<std::size_t>(corner[1])].triangle >= 0 &&
                           followers[static_cast<std::size_t>(corner[2])].triangle >= 0;
      const Eigen::Vector3f n = (now_mm.col(corner[1]) - now_mm.col(corner[0]))
                                    .cross(now_mm.col(corner[2]) - now_mm.col(corner[0]));
      folded += counted && n.dot(normals.col(corner[0]) + normals.col(corner[1]) + normals.col(corner[2])) < 0
                    ? 1
                    : 0;
    }
    all_distances.insert(all_distances.end(), distances.begin(), distances.end());
    const Spread distance(std::move(distances));
    const Spread drift(std::move(drifts));
    if (m < 3 || m % 10 == 9 || m + 1 == meshes) {
      fmt::print(
          "mesh {:3d}: distance mean {:.3f} p95 {:.3f} mm, drift mean {:.3f} p95 {:.3f} max {:.1f} mm, "
          "folded {}; {} after {}, rms {:.3f} mm {:.2f} px, seen {:.0f} %, followed {:.0f} %\n",
          m, distance.mean(), distance.at(0.95), drift.mean(), drift.at(0.95), drift.at(1), folded,
          to_string(report.outcome), report.steps, report.surface_rms_mm, report.motion_rms_px,
          100 * report.seen, 100 * report.followed);
    }
    before = std::move(pictures);
  }
  const Spread all(std::move(all_distances));
  fmt::print(
      "all: distance mean {:.3f} p95 {:.3f} mm; track {:.0f} ms, flow of {} cameras {:.0f} ms, stereo {:.0f} "
      "ms a mesh\n",
      all.mean(), all.at(0.95), Spread(fit_ms).mean(), colour.size(), Spread(flow_ms).mean(),
      Spread(stereo_ms).mean());
  if (!sheet.empty()) {
    const capture::Lens& lens = rig.cameras[colour.back()].lens;
    const render::Picture picture = render::to_picture(before.back());
    render::Picture out = render::plain_picture(4 * picture.width_px, picture.height_px, {0, 0, 0});
    render::paste(out, picture, 0, 0);
    const render::Picture dark = render::plain_picture(picture.width_px, picture.height_px, {20, 20, 20});
    render::paste(out, draw(*surface, now_mm, nullptr, lens, dark), picture.width_px, 0);
    render::paste(out, draw(*surface, now_mm, &distance_heat, lens, dark), 2 * picture.width_px, 0);
    render::paste(out, draw(*surface, now_mm, &drift_heat, lens, dark), 3 * picture.width_px, 0);
    render::write_png(out, sheet);
  }
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
