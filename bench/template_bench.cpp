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
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <numbers>
#include <numeric>
#include <random>

#include "booth/booth_shading.hpp"
#include "capture/depth_map.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "fit/fine_surface.hpp"
#include "fit/skin_tracker.hpp"
#include "fit/template_mesh.hpp"
#include "gpu/context.hpp"
#include "render/renderer.hpp"
#include "simulation/virtual_booth.hpp"
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
  StereoDepth(gpu::Context& context, const simulation::VirtualBooth& booth) : booth_(booth) {
    stereo::StereoOptions options;
    options.depths = {850, 1250};
    options.most_slots = kSlots;
    for (const capture::StereoPair& pair : booth.rig().pairs) {
      matchers_.push_back(std::make_unique<stereo::StereoMatcher>(context, booth.rig(), pair, options));
    }
  }
  std::vector<capture::DepthMap> at(std::uint64_t blank) {
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
    for (std::size_t p = 0; p < matchers_.size(); ++p) {
      if (matchers_[p]->match(slots[p], maps_) != stereo::StereoOutcome::Done) {
        throw Error(ErrorKind::Internal, matchers_[p]->failure());
      }
      result.push_back(std::move(maps_[kSlots / 2]));
    }
    return result;
  }

 private:
  static constexpr int kSlots = 5;
  const simulation::VirtualBooth& booth_;
  std::vector<std::unique_ptr<stereo::StereoMatcher>> matchers_;
  std::vector<capture::DepthMap> maps_;
};

/// The booth's slots, kept in a folder where one is given: rendering takes longer than all that is measured.
class Footage {
 public:
  Footage(const simulation::VirtualBooth& booth, std::filesystem::path folder)
      : booth_(booth), folder_(std::move(folder)), triangles_(booth.slot(0).surface().triangles) {
    if (!folder_.empty()) {
      const simulation::VirtualBoothConfig& config = booth.config();
      folder_ /= fmt::format("{}-{}-{}{}", config.seed, config.samples, config.head_motion,
                             config.actor_seed ? fmt::format("-{}", *config.actor_seed) : "");
      std::filesystem::create_directories(folder_);
    }
  }

  simulation::TruthMesh truth(std::uint64_t slot) const {
    simulation::TruthMesh mesh;
    const auto bytes = kept(fmt::format("{}-truth", slot), [&] {
      const mesh::Vertices vertices_mm = booth_.slot(slot).surface().vertices_mm;
      return bytes_of(vertices_mm.data(), static_cast<std::size_t>(vertices_mm.size()));
    });
    mesh.vertices_mm.resize(3, static_cast<Eigen::Index>(bytes.size() / (3 * sizeof(float))));
    std::memcpy(mesh.vertices_mm.data(), bytes.data(), bytes.size());
    mesh.triangles = triangles_;
    mesh::vertex_normals(mesh.vertices_mm, mesh.triangles, mesh.normals);
    return mesh;
  }

  Frame picture(std::uint64_t slot, std::size_t camera) const {
    const capture::Lens& lens = booth_.rig().cameras[camera].lens;
    Frame frame;
    frame.width_px = lens.width_px;
    frame.height_px = lens.height_px;
    frame.stride_bytes = 4 * static_cast<std::size_t>(lens.width_px);
    const std::size_t size = frame.stride_bytes * static_cast<std::size_t>(lens.height_px);
    const auto bytes = kept(fmt::format("{}-camera{}", slot, camera), [&] {
      const Frame seen = booth_.slot(slot).frame(camera);
      std::vector<char> pixels(size);
      for (int y = 0; y < seen.height_px; ++y) {
        std::memcpy(pixels.data() + static_cast<std::size_t>(y) * frame.stride_bytes, seen.row(y),
                    frame.stride_bytes);
      }
      return pixels;
    });
    auto pixels = std::make_shared<std::uint8_t[]>(size);
    std::memcpy(pixels.get(), bytes.data(), size);
    frame.pixels = std::move(pixels);
    return frame;
  }

  /// Of both pairs; matchers is asked where the folder does not hold it.
  std::vector<capture::DepthMap> stereo(std::uint64_t slot, StereoDepth& matchers) const {
    std::vector<capture::DepthMap> maps;
    for (std::size_t p = 0; p < booth_.rig().pairs.size(); ++p) {
      const auto bytes = kept(fmt::format("{}-stereo{}", slot, p), [&] {
        if (maps_slot_ != slot || maps_.empty()) {
          maps_ = matchers.at(slot);
          maps_slot_ = slot;
        }
        const capture::DepthMap& map = maps_[p];
        std::vector<float> values(map.depth_mm);
        values.insert(values.end(), map.sigma_mm.begin(), map.sigma_mm.end());
        values.insert(values.end(), map.confidence.begin(), map.confidence.end());
        for (const double value : {static_cast<double>(map.width_px), static_cast<double>(map.height_px),
                                   map.lens.fx_px, map.lens.fy_px, map.lens.cx_px, map.lens.cy_px}) {
          values.push_back(static_cast<float>(value));
        }
        for (Eigen::Index i = 0; i < 16; ++i) {
          values.push_back(static_cast<float>(map.lens.camera_from_rig.matrix()(i % 4, i / 4)));
        }
        return bytes_of(values.data(), values.size());
      });
      constexpr std::size_t kLensValues = 6 + 16;
      std::vector<float> values(bytes.size() / sizeof(float));
      std::memcpy(values.data(), bytes.data(), bytes.size());
      const std::size_t pixels = (values.size() - kLensValues) / 3;
      const float* lens = values.data() + 3 * pixels;
      capture::DepthMap& map = maps.emplace_back();
      map.width_px = map.lens.width_px = static_cast<int>(lens[0]);
      map.height_px = map.lens.height_px = static_cast<int>(lens[1]);
      map.lens.fx_px = static_cast<double>(lens[2]);
      map.lens.fy_px = static_cast<double>(lens[3]);
      map.lens.cx_px = static_cast<double>(lens[4]);
      map.lens.cy_px = static_cast<double>(lens[5]);
      for (Eigen::Index i = 0; i < 16; ++i) {
        map.lens.camera_from_rig.matrix()(i % 4, i / 4) = static_cast<double>(lens[6 + i]);
      }
      map.depth_mm.assign(values.data(), values.data() + pixels);
      map.sigma_mm.assign(values.data() + pixels, values.data() + 2 * pixels);
      map.confidence.assign(values.data() + 2 * pixels, values.data() + 3 * pixels);
    }
    return maps;
  }

 private:
  static std::vector<char> bytes_of(const float* values, std::size_t count) {
    std::vector<char> bytes(count * sizeof(float));
    std::memcpy(bytes.data(), values, bytes.size());
    return bytes;
  }
  std::vector<char> kept(const std::string& name, const std::function<std::vector<char>()>& make) const {
    if (folder_.empty()) {
      return make();
    }
    const std::filesystem::path file = folder_ / name;
    if (std::ifstream in(file, std::ios::binary | std::ios::ate); in) {
      std::vector<char> bytes(static_cast<std::size_t>(in.tellg()));
      in.seekg(0);
      in.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
      return bytes;
    }
    std::vector<char> bytes = make();
    std::ofstream(file, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    return bytes;
  }

  const simulation::VirtualBooth& booth_;
  std::filesystem::path folder_;
  mesh::Triangles triangles_;
  mutable std::vector<capture::DepthMap> maps_;
  mutable std::uint64_t maps_slot_ = 0;
};

/// What a sensor adds anew to each picture of the same thing.
void add_noise(Frame& frame, std::mt19937_64& random) {
  constexpr double kLevels = 1.5;
  std::normal_distribution<double> noise(0, kLevels);
  const std::size_t size = frame.stride_bytes * static_cast<std::size_t>(frame.height_px);
  auto pixels = std::make_shared<std::uint8_t[]>(size);
  for (std::size_t i = 0; i < size; ++i) {
    pixels[i] = static_cast<std::uint8_t>(
        std::lround(std::clamp(static_cast<double>(frame.pixels[i]) + noise(random), 0.0, 255.0)));
  }
  frame.pixels = std::move(pixels);
}

struct Follower {
  std::int32_t triangle = -1;
  Eigen::Vector2f barycentric{0, 0};
};

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

/// Triangles that look the other way than the surface around them, of those whose corners all count.
int find_folded(const mesh::Triangles& triangles, const mesh::Vertices& vertices_mm,
                const std::function<bool(std::size_t)>& counts, std::vector<std::uint8_t>& folded) {
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(vertices_mm, triangles, normals);
  folded.assign(static_cast<std::size_t>(triangles.cols()), 0);
  int found = 0;
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const auto corner = triangles.col(t);
    const Eigen::Vector3f n = (vertices_mm.col(corner[1]) - vertices_mm.col(corner[0]))
                                  .cross(vertices_mm.col(corner[2]) - vertices_mm.col(corner[0]));
    if (counts(static_cast<std::size_t>(corner[0])) && counts(static_cast<std::size_t>(corner[1])) &&
        counts(static_cast<std::size_t>(corner[2])) &&
        n.dot(normals.col(corner[0]) + normals.col(corner[1]) + normals.col(corner[2])) < 0) {
      folded[static_cast<std::size_t>(t)] = 1;
      ++found;
    }
  }
  return found;
}

/// From the true skin to a mesh: distances in mm and angles between the normals in degrees.
struct SurfaceError {
  std::vector<double> distances_mm;
  std::vector<double> angles_deg;

  /// skin: [truth vertex_count]; counts: whether a vertex of the mesh does
  void add(const simulation::TruthMesh& truth, const Eigen::VectorXf& skin, const mesh::Triangles& triangles,
           const mesh::Vertices& vertices_mm, const std::function<bool(std::size_t)>& counts) {
    const render::Raycaster caster(vertices_mm, triangles);
    Eigen::Matrix3Xf normals;
    mesh::vertex_normals(vertices_mm, triangles, normals);
    for (Eigen::Index v = 0; v < truth.vertices_mm.cols(); v += 3) {
      if (skin[v] < 0.9F) {
        continue;
      }
      const auto hit = caster.closest_point(truth.vertices_mm.col(v), 5);
      if (hit.triangle < 0) {
        continue;
      }
      const auto corner = triangles.col(hit.triangle);
      if (!counts(static_cast<std::size_t>(corner[0])) || !counts(static_cast<std::size_t>(corner[1])) ||
          !counts(static_cast<std::size_t>(corner[2]))) {
        continue;
      }
      distances_mm.push_back(static_cast<double>(hit.distance_mm));
      const float cosine = render::interpolate(triangles, hit.triangle, hit.barycentric, normals)
                               .normalized()
                               .dot(truth.normals.col(v));
      angles_deg.push_back(std::acos(std::clamp(static_cast<double>(cosine), -1.0, 1.0)) * 180 /
                           std::numbers::pi);
    }
  }
};

int run(int argc, char** argv) {
  CLI::App app{"Fits and tracks the template in the virtual booth and measures it against the truth."};
  std::string model_file = "assets/default.facemodel";
  std::string sheet;
  std::string cache;
  std::vector<int> sheet_at;
  fit::FineOptions fine_options;
  fine_options.sweeps = 0;
  simulation::VirtualBoothConfig config;
  config.seed = 5;
  int meshes = 30;
  double noise_mm = 0.1;
  bool no_flow = false;
  int still = 1'000'000;
  std::vector<int> gap = {1'000'000, 0};
  std::uint64_t stranger = 0;
  bool all_cameras = false;
  bool with_stereo = false;
  bool with_between = false;
  bool with_shading = false;
  refine::RefinerConfig shading = booth::booth_refinement();
  std::uint64_t first_slot = 150;
  fit::SkinTrackerOptions tracking;
  fit::FitOptions& options = tracking.fit;
  std::int32_t vertices = 18'000;
  app.add_option("--model", model_file, "Face model");
  app.add_option("--seed", config.seed, "Of booth and actor");
  app.add_option("--meshes", meshes, "20 a second");
  app.add_option("--vertices", vertices, "Of the template, at most");
  app.add_option("--samples", config.samples, "Rays a pixel");
  app.add_option("--head-motion", config.head_motion, "Share of the performance's");
  app.add_flag("--stereo", with_stereo, "Depth from the cameras' pictures");
  app.add_flag("--between", with_between, "The slots with stripes, too: a mesh between those of blank slots");
  app.add_option("--first-slot", first_slot, "A multiple of 3; the face is at rest before 150");
  app.add_option("--depth-noise", noise_mm, "mm");
  app.add_option("--alpha", options.alpha);
  app.add_option("--beta", options.beta);
  app.add_option("--steps", options.steps);
  app.add_option("--model-steps", options.model_steps, "Over pose and expressions before each fit");
  app.add_flag("!--no-unfold", options.unfolds, "Folded triangles are left");
  app.add_option("--reference-weight", tracking.reference_weight);
  app.add_option("--reference-sigma", tracking.reference_sigma_px, "px");
  app.add_option("--gamma", options.gamma, "Of the temporal term");
  app.add_option("--sigma-t", options.sigma_t_mm, "mm");
  app.add_option("--still", still, "Meshes from this one on see its slot again, with other noise");
  app.add_option("--gap", gap, "First mesh that is left out, and how many")->expected(2);
  app.add_option("--stranger", stranger, "Seed of somebody else's face, seen once at the gap's end");
  app.add_option("--cg", options.cg_iterations);
  app.add_flag("--no-flow", no_flow, "Depth alone");
  app.add_flag("--all-cameras", all_cameras, "Flow in the monochrome cameras' blank pictures, too");
  app.add_flag("!--no-redraw", tracking.redraws,
               "The picture before is not drawn again where the mesh is found");
  app.add_flag("!--no-reference", tracking.uses_reference,
               "Flow from picture to picture alone, as in the paper");
  app.add_flag("!--no-expressions", options.knows_expressions, "E_r knows the pose alone");
  app.add_flag("!--fixed-rest", options.turns_with_the_head, "E_r as in the paper");
  app.add_option("--fine", fine_options.sweeps, "Sweeps below the template; 0: none");
  app.add_option("--fine-smoothness", fine_options.smoothness);
  app.add_flag("--shading", with_shading, "Shading on top of the fine levels");
  app.add_option("--shading-prior", shading.weights.displacement_hierarchy, "w4: towards the depth maps");
  app.add_option("--shading-smooth", shading.weights.displacement_smooth, "w3");
  app.add_option("--shading-steps", shading.gauss_newton_steps);
  app.add_option("--shading-robust", shading.robust_scale);
  app.add_option("--shading-albedo-frames", shading.albedo_frames);
  app.add_option("--shading-albedo-smooth", shading.weights.albedo_smooth, "w2");
  app.add_option("--cache", cache,
                 "Folder that keeps what was rendered; to be emptied when booth or face model change");
  app.add_option("--sheet", sheet, "PNG: picture, template, error of surface and of drift");
  app.add_option("--sheet-at", sheet_at,
                 "Meshes of which a sheet is made, their number before its name's end");
  CLI11_PARSE(app, argc, argv);

  const face::FaceModel model = face::FaceModel::load(model_file);
  const simulation::VirtualBooth booth(&model, config);
  const capture::Rig& rig = booth.rig();
  const auto surface = std::make_shared<const fit::TemplateMesh>(fit::make_template(model, vertices));
  fmt::print("template: {} vertices, {} triangles\n", surface->vertex_count(), surface->triangles.cols());
  std::vector<std::size_t> colour;
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    if (rig.cameras[i].colour || all_cameras) {
      colour.push_back(i);
    }
  }
  std::vector<capture::Lens> lenses;
  for (const std::size_t camera : colour) {
    lenses.push_back(rig.cameras[camera].lens);
  }
  fit::SkinTracker tracker(surface, lenses, tracking);
  std::unique_ptr<gpu::Context> context;
  std::unique_ptr<StereoDepth> depth;
  if (with_stereo) {
    context = std::make_unique<gpu::Context>(gpu::ContextOptions());
    depth = std::make_unique<StereoDepth>(*context, booth);
  }
  const Footage footage(booth, cache);
  std::unique_ptr<fit::FineSurface> fine;
  std::vector<float> displacements_mm;
  std::vector<float> fine_confidence;
  SurfaceError template_error;
  SurfaceError fine_error;
  SurfaceError shaded_error;
  std::unique_ptr<booth::BoothShading> shade;
  std::vector<float> shading_mm;
  std::vector<float> shaded_mm;
  int shading_turned = 0;
  int shading_folded = 0;
  std::vector<double> shade_ms;
  std::vector<double> fine_ms;
  if (fine_options.sweeps > 0) {
    fine = std::make_unique<fit::FineSurface>(model.control, surface, fine_options);
    fmt::print("fine surface: {} vertices, {} triangles\n", fine->hierarchy()->finest().vertex_count,
               fine->hierarchy()->finest().triangles.cols());
    if (with_shading) {
      shade = std::make_unique<booth::BoothShading>("auto", rig, shading);
      shade->begin(*fine->hierarchy(), *surface, model);
    }
  }
  mesh::Vertices control_mm;
  model.evaluate({}, {}, control_mm);
  std::vector<Follower> followers(static_cast<std::size_t>(surface->vertex_count()));
  std::vector<double> follow_ms;
  std::vector<float> distance_heat(followers.size());
  std::vector<float> drift_heat(followers.size());
  std::vector<double> all_distances;
  std::vector<std::uint8_t> folded_triangles;
  std::vector<std::uint8_t> fine_folded_triangles;
  int folded_ever = 0;
  mesh::Vertices older_mm;
  mesh::Vertices last_mm;
  mesh::Vertices before_truth_mm;
  double jitter_squares = 0;
  double jitter_count = 0;
  double lag_sum = 0;
  double lag_squares = 0;
  double worst_rejected = 0;
  double worst_rms = 0;
  double worst_shape = 0;
  double least_trust = 1;
  double least_seen = 1;
  double worst_drift = 0;
  double worst_drift_95 = 0;
  int fine_folded = 0;
  struct {
    std::array<std::vector<double>, 2> distances;  ///< [0]: of the way between the meshes, [1]: settled
    std::array<std::vector<double>, 2> drifts;
    std::vector<double> ms;
  } between;
  mesh::Vertices fine_mm;
  Eigen::Matrix3Xf fine_normals;
  for (int m = 0; m < meshes; ++m) {
    if (m >= gap[0] && m < gap[0] + gap[1]) {
      continue;
    }
    const std::uint64_t slot = first_slot + static_cast<std::uint64_t>(3 * std::min(m, still) + 2);
    std::mt19937_64 random(config.seed * 100'000 + first_slot + static_cast<std::uint64_t>(3 * m));
    const simulation::TruthMesh truth = footage.truth(slot);
    const auto maps_of = [&](std::uint64_t at, const simulation::TruthMesh& face) {
      if (with_stereo) {
        return footage.stereo(at, *depth);
      }
      std::vector<capture::DepthMap> found;
      for (const capture::StereoPair& pair : rig.pairs) {
        found.push_back(depth_of(face, rig.cameras[pair.left].lens, noise_mm, random));
      }
      return found;
    };
    const std::vector<capture::DepthMap> maps = maps_of(slot, truth);
    std::vector<Frame> pictures;
    for (const std::size_t camera : colour) {
      pictures.push_back(footage.picture(slot, camera));
      if (m > still) {
        add_noise(pictures.back(), random);
      }
    }
    const render::Raycaster caster(truth.vertices_mm, truth.triangles);
    fit::TemplateFitReport report;
    // Landmarks as a detector finds them: 1 mm of noise.
    const auto placed_by_landmarks = [&](const simulation::TruthMesh& face) {
      std::vector<fit::Correspondence> correspondences;
      std::normal_distribution<double> noise(0, 1);
      for (const face::LandmarkAnchor& anchor : model.landmarks) {
        if (anchor.weights[0] + anchor.weights[1] + anchor.weights[2] > 0.5F &&
            correspondences.size() < 468) {
          const Eigen::Vector3d at =
              face::FaceModel::anchor_point(anchor, face.vertices_mm.leftCols(model.vertex_count()))
                  .cast<double>();
          correspondences.push_back(
              {anchor, at + Eigen::Vector3d(noise(random), noise(random), noise(random))});
        }
      }
      fit::Placement placed = fit::place(*surface, control_mm, correspondences);
      fmt::print("placed by {} landmarks, rms {:.2f} mm\n", correspondences.size(), placed.rms_mm);
      return placed;
    };
    const std::vector<Frame> none(pictures.size());
    const std::span<const Frame> seen_pictures(no_flow ? none.data() : pictures.data(), pictures.size());
    const auto asked = Clock::now();
    if (m == 0) {
      const fit::Placement placed = placed_by_landmarks(truth);
      report = tracker.start(placed, maps, seen_pictures);
      fmt::print("fit: {} after {} steps, {:.0f} ms, rms {:.3f} mm, {:.0f} % seen\n",
                 to_string(report.outcome), report.steps, ms_since(asked), report.surface_rms_mm,
                 100 * report.seen);
      for (std::int32_t v = 0; v < surface->vertex_count(); ++v) {
        const auto vertex = static_cast<std::size_t>(v);
        const auto hit = caster.closest_point(tracker.vertices_mm().col(v), 2);
        if (surface->is_skin[vertex] != 0 && tracker.depth_weight()[vertex] > 0.2F && hit.triangle >= 0 &&
            booth.skin()[truth.triangles(0, hit.triangle)] > 0.9F) {
          followers[vertex] = {hit.triangle, hit.barycentric};
        }
      }
    } else {
      if (m == gap[0] + gap[1]) {
        report = tracker.follow(maps, seen_pictures);
        fmt::print("mesh {:3d}: after the gap, from where it was: {}\n", m,
                   report.lost ? "lost, " + report.lost_because : "not noticed");
        if (stranger != 0) {
          simulation::VirtualBoothConfig other_config = config;
          other_config.actor_seed = stranger;
          const simulation::VirtualBooth other(&model, other_config);
          const Footage other_footage(other, cache);
          const simulation::TruthMesh other_truth = other_footage.truth(slot);
          std::vector<capture::DepthMap> other_maps;
          for (const capture::StereoPair& pair : rig.pairs) {
            other_maps.push_back(depth_of(other_truth, rig.cameras[pair.left].lens, noise_mm, random));
          }
          std::vector<Frame> other_pictures;
          for (const std::size_t camera : colour) {
            other_pictures.push_back(other_footage.picture(slot, camera));
          }
          const fit::TemplateFitReport judged =
              tracker.find_again(placed_by_landmarks(other_truth), other_maps, other_pictures);
          fmt::print("mesh {:3d}: somebody else: {}, shape {:.2f} mm, rms {:.2f} mm, flow trust {:.2f}\n", m,
                     judged.lost ? "lost, " + judged.lost_because : "not noticed", judged.shape_rms_mm,
                     judged.surface_rms_mm, judged.flow_trust);
        }
        report = tracker.find_again(placed_by_landmarks(truth), maps, seen_pictures);
      } else {
        report = tracker.follow(maps, seen_pictures);
      }
      follow_ms.push_back(ms_since(asked));
    }
    const mesh::Vertices& now_mm = tracker.vertices_mm();
    if (report.lost) {
      fmt::print("mesh {:3d}: lost, {}\n", m, report.lost_because);
    }
    worst_rejected = std::max(worst_rejected, report.rejected);
    worst_rms = std::max(worst_rms, report.surface_rms_mm);
    worst_shape = std::max(worst_shape, m > 0 ? report.shape_rms_mm : 0);
    if (m > 0) {
      least_trust = std::min(least_trust, report.flow_trust);
    }
    least_seen = std::min(least_seen, report.seen);
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
    for (int k = 1; k <= 2 && with_between && tracker.follows() && m < still; ++k) {
      const std::uint64_t slot_between = slot - 3 + static_cast<std::uint64_t>(k);
      const simulation::TruthMesh truth_between = footage.truth(slot_between);
      const auto settling = Clock::now();
      mesh::Vertices settled_mm;
      Eigen::VectorXd expression;
      tracker.between(k / 3.0, maps_of(slot_between, truth_between), settled_mm, expression);
      between.ms.push_back(ms_since(settling));
      const mesh::Vertices way_mm = last_mm + static_cast<float>(k) / 3 * (now_mm - last_mm);
      const render::Raycaster there(truth_between.vertices_mm, truth_between.triangles);
      for (std::size_t v = 0; v < followers.size(); ++v) {
        if (followers[v].triangle < 0) {
          continue;
        }
        const Eigen::Vector3f true_mm = render::interpolate(
            truth.triangles, followers[v].triangle, followers[v].barycentric, truth_between.vertices_mm);
        for (const bool settled : {false, true}) {
          const Eigen::Vector3f at = (settled ? settled_mm : way_mm).col(static_cast<Eigen::Index>(v));
          const auto hit = there.closest_point(at, 30);
          between.distances[settled].push_back(hit.triangle >= 0 ? static_cast<double>(hit.distance_mm)
                                                                 : 30.0);
          between.drifts[settled].push_back(static_cast<double>((true_mm - at).norm()));
        }
      }
    }
    // Second differences over three meshes, and how far it lags behind what moves.
    if (older_mm.cols() > 0) {
      for (std::size_t v = 0; v < followers.size(); ++v) {
        if (followers[v].triangle >= 0) {
          const auto column = static_cast<Eigen::Index>(v);
          jitter_squares += static_cast<double>(
              (now_mm.col(column) - 2 * last_mm.col(column) + older_mm.col(column)).squaredNorm());
          jitter_count += 1;
        }
      }
    }
    older_mm = last_mm;
    last_mm = now_mm;
    const mesh::Vertices truth_move_mm =
        m > 0 ? mesh::Vertices(truth.vertices_mm - before_truth_mm) : mesh::Vertices();
    for (std::size_t v = 0; v < followers.size() && m > 0; ++v) {
      if (followers[v].triangle >= 0) {
        const Eigen::Vector3f move = render::interpolate(truth.triangles, followers[v].triangle,
                                                         followers[v].barycentric, truth_move_mm);
        const Eigen::Vector3f behind = render::interpolate(truth.triangles, followers[v].triangle,
                                                           followers[v].barycentric, truth.vertices_mm) -
                                       now_mm.col(static_cast<Eigen::Index>(v));
        if (move.norm() > 2) {
          lag_sum += static_cast<double>(behind.dot(move));
          lag_squares += static_cast<double>(move.squaredNorm());
        }
      }
    }
    before_truth_mm = truth.vertices_mm;
    const int folded = find_folded(
        surface->triangles, now_mm, [&](std::size_t v) { return followers[v].triangle >= 0; },
        folded_triangles);
    folded_ever += folded;
    if (fine != nullptr) {
      const auto begun = Clock::now();
      fine->fit(maps, now_mm, displacements_mm, fine_confidence);
      fine_ms.push_back(ms_since(begun));
      mesh::rebuild_finest(*fine->hierarchy(), now_mm, displacements_mm, fine_mm, fine_normals);
      const auto seen = [&](std::size_t v) { return fine_confidence[v] > 0.2F; };
      if (m % 10 == 0 || m + 1 == meshes) {
        template_error.add(truth, booth.skin(), surface->triangles, now_mm, seen);
        fine_error.add(truth, booth.skin(), fine->hierarchy()->finest().triangles, fine_mm, seen);
      }
      if (shade != nullptr) {
        const auto shading_from = Clock::now();
        const std::string missing = shade->refine(pictures, now_mm, displacements_mm, shading_mm);
        shading_turned += fine->add(now_mm, displacements_mm, shading_mm, shaded_mm);
        shade_ms.push_back(ms_since(shading_from));
        // As it would be without that.
        for (std::size_t v = 0; v < shading_mm.size(); ++v) {
          shading_mm[v] += displacements_mm[v];
        }
        mesh::rebuild_finest(*fine->hierarchy(), now_mm, shading_mm, fine_mm, fine_normals);
        shading_folded +=
            find_folded(fine->hierarchy()->finest().triangles, fine_mm, seen, fine_folded_triangles);
        if (!missing.empty()) {
          fmt::print("mesh {:3d}: {}\n", m, missing);
        }
        mesh::rebuild_finest(*fine->hierarchy(), now_mm, shaded_mm, fine_mm, fine_normals);
        if (m % 10 == 0 || m + 1 == meshes) {
          shaded_error.add(truth, booth.skin(), fine->hierarchy()->finest().triangles, fine_mm, seen);
        }
      }
      fine_folded += find_folded(fine->hierarchy()->finest().triangles, fine_mm, seen, fine_folded_triangles);
    }
    all_distances.insert(all_distances.end(), distances.begin(), distances.end());
    const Spread distance(std::move(distances));
    const Spread drift(std::move(drifts));
    worst_drift = std::max(worst_drift, drift.mean());
    worst_drift_95 = std::max(worst_drift_95, drift.at(0.95));
    if (m < 3 || m % 10 == 9 || m + 1 == meshes || folded > 0) {
      fmt::print(
          "mesh {:3d}: distance mean {:.3f} p95 {:.3f} mm, drift mean {:.3f} p95 {:.3f} max {:.1f} mm, "
          "folded {}; {} after {}, rms {:.3f} mm {:.2f} px, seen {:.0f} %, followed {:.0f} %\n",
          m, distance.mean(), distance.at(0.95), drift.mean(), drift.at(0.95), drift.at(1), folded,
          to_string(report.outcome), report.steps, report.surface_rms_mm, report.motion_rms_px,
          100 * report.seen, 100 * report.followed);
    }
    if (!sheet.empty() && (m + 1 == meshes || std::count(sheet_at.begin(), sheet_at.end(), m) > 0)) {
      // The face in the last colour camera's picture, twice as large.
      constexpr int kPart_px = 300;
      const capture::Lens& whole = rig.cameras[colour.back()].lens;
      mesh::Vertices counted_mm(3, 0);
      for (std::size_t v = 0; v < followers.size(); ++v) {
        if (followers[v].triangle >= 0) {
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
          render::resize(render::crop(render::to_picture(pictures.back()), static_cast<int>(x),
                                      static_cast<int>(y), kPart_px, kPart_px),
                         lens.width_px, lens.height_px);
      std::vector<render::Picture> parts = {
          picture, draw(surface->triangles, now_mm, nullptr, &folded_triangles, lens),
          draw(surface->triangles, now_mm, &distance_heat, nullptr, lens),
          draw(surface->triangles, now_mm, &drift_heat, &folded_triangles, lens)};
      if (fine != nullptr) {
        parts.push_back(
            draw(fine->hierarchy()->finest().triangles, fine_mm, nullptr, &fine_folded_triangles, lens));
        parts.push_back(draw(truth.triangles, truth.vertices_mm, nullptr, nullptr, lens));
      }
      const int columns = static_cast<int>(parts.size()) / 2;
      render::Picture out = render::plain_picture(columns * lens.width_px, 2 * lens.height_px, {0, 0, 0});
      for (int i = 0; i < static_cast<int>(parts.size()); ++i) {
        render::paste(out, parts[static_cast<std::size_t>(i)], i % columns * lens.width_px,
                      i / columns * lens.height_px);
      }
      std::filesystem::path file = sheet;
      if (m + 1 != meshes) {
        file.replace_filename(fmt::format("{}-{}{}", file.stem().string(), m, file.extension().string()));
      }
      render::write_png(out, file);
    }
  }
  const Spread all(std::move(all_distances));
  fmt::print("all: distance mean {:.3f} p95 {:.3f} mm, folded {} in all; {:.0f} ms a mesh with {} cameras\n",
             all.mean(), all.at(0.95), folded_ever, Spread(follow_ms).mean(), colour.size());
  for (const bool settled : {false, true}) {
    if (with_between) {
      const Spread distance(between.distances[settled]);
      const Spread drift(between.drifts[settled]);
      fmt::print("between, {}: distance mean {:.3f} p95 {:.3f} mm, skin point mean {:.2f} p95 {:.2f} mm{}\n",
                 settled ? "on the depth maps" : "half way alone", distance.mean(), distance.at(0.95),
                 drift.mean(), drift.at(0.95),
                 settled ? fmt::format("; {:.0f} ms a mesh", Spread(between.ms).mean()) : "");
    }
  }
  fmt::print(
      "worst drift mean {:.3f} p95 {:.3f} mm; second differences {:.4f} mm rms, lag {:.4f} meshes; seen >= "
      "{:.2f}, "
      "rejected <= {:.3f}, rms <= {:.2f} mm, shape <= {:.2f} mm, flow trust >= {:.2f}\n",
      worst_drift, worst_drift_95, std::sqrt(jitter_squares / std::max(jitter_count, 1.0)),
      lag_sum / std::max(lag_squares, 1e-9), least_seen, worst_rejected, worst_rms, worst_shape, least_trust);
  if (fine != nullptr) {
    for (const auto& [name, error] : {std::pair<const char*, const SurfaceError&>("template", template_error),
                                      {"fine", fine_error},
                                      {"shaded", shaded_error}}) {
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
    fmt::print("fine: folded {} in all; {:.0f} ms a mesh\n", fine_folded, Spread(fine_ms).mean());
    if (shade != nullptr) {
      fmt::print("shading: {:.0f} ms a mesh; added as it comes {} folded in all, {} turned over or nearly\n",
                 Spread(shade_ms).mean(), shading_folded, shading_turned);
    }
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
