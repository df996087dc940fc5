#include "simulation/virtual_booth.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <utility>

#include "facet/error.hpp"
#include "maths/harmonics.hpp"
#include "maths/statistics.hpp"
#include "render/renderer.hpp"
#include "simulation/booth_rig.hpp"
#include "simulation/gloss.hpp"
#include "simulation/lens_rays.hpp"
#include "simulation/light.hpp"
#include "simulation/placed_actor.hpp"
#include "simulation/random.hpp"
#include "simulation/recorded_curves.hpp"
#include "simulation/sensor.hpp"
#include "simulation/shading.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr std::uint64_t kTargetStream = 92;
constexpr std::uint64_t kCameraStream = 93;
constexpr double kPerformance_s = 600;  // the same for every length of take, so that slots are the same
constexpr float kLift_mm = 0.3F;        // shadow rays start off the surface by less than a wrinkle's depth
constexpr float kBrightSkin = 0.85F;    // linear value of the brightest skin under both projectors' white
constexpr float kBackdrop = 0.004F;     // of black cloth, linear
constexpr float kTargetAlbedo = 0.6F;
/// What a monochrome sensor sees of red, green and blue.
const Vector3f kMonochrome(0.33F, 0.4F, 0.27F);
/// Industrial cameras of this size of pixel.
constexpr float kFullWell_e = 12'000;
constexpr float kReadNoise_e = 10;

/// Part of the room that lights what lies in sockets and mouth.
float openness_of(Material material) {
  switch (material) {
    case Material::Eye:
      return 0.7F;
    case Material::Tooth:
      return 0.4F;
    case Material::Skin:
    case Material::Hair:
    case Material::Cloth:
    case Material::Frame:
      return 1;
  }
  return 1;
}

void check(const face::FaceModel* model, const VirtualBoothConfig& config) {
  const auto refuse = [](const std::string& what) {
    throw Error(ErrorKind::Usage, "virtual booth: " + what);
  };
  if (config.scene == BoothScene::Actor && model == nullptr) {
    refuse("an actor needs a face model");
  }
  if (!(config.resolution >= 0.25 && config.resolution <= 4)) {
    refuse(fmt::format("cameras of {} times 640x480 px: 0.25 to 4", config.resolution));
  }
  if (!(config.slots_per_second >= 1 && config.slots_per_second <= 1000)) {
    refuse(fmt::format("{} slots per second: 1 to 1000", config.slots_per_second));
  }
  if (!(config.exposure_ms >= 0 && config.exposure_ms * config.slots_per_second <= 1000)) {
    refuse(fmt::format("an exposure of {} ms: 0 to a slot's length, {:.3f} ms", config.exposure_ms,
                       1000 / config.slots_per_second));
  }
  if (config.samples < 1 || config.samples > 64) {
    refuse(fmt::format("{} samples a pixel: 1 to 64", config.samples));
  }
  if (!(config.head_motion >= 0 && config.head_motion <= 1)) {
    refuse(fmt::format("a head motion of {}: 0 to 1", config.head_motion));
  }
  if (config.pose_s && !(*config.pose_s >= 0 && *config.pose_s <= kPerformance_s)) {
    refuse(fmt::format("a pose at {} s: 0 to {} s", *config.pose_s, kPerformance_s));
  }
  if (!(config.target_shift_mm.norm() <= 200)) {
    refuse(fmt::format("a target {:.0f} mm off its place: 0 to 200", config.target_shift_mm.norm()));
  }
  if (!(config.ambient >= 0 && config.ambient <= 10)) {
    refuse(fmt::format("room light of {}: 0 to 10", config.ambient));
  }
  if (!(config.projector_blur_px >= 0 && config.projector_blur_px <= 3)) {
    refuse(fmt::format("a projector's blur of {} px: 0 to 3", config.projector_blur_px));
  }
}

/// A target with its scene, vertices of the surface exact.
struct Target {
  BoothTarget form;
  Scene scene;
};

/// A grid of columns x rows vertices as triangles.
mesh::Triangles grid_triangles(int columns, int rows) {
  mesh::Triangles triangles(3, 2 * static_cast<Eigen::Index>(columns - 1) * (rows - 1));
  Eigen::Index t = 0;
  for (int row = 0; row + 1 < rows; ++row) {
    for (int column = 0; column + 1 < columns; ++column) {
      const int at = row * columns + column;
      triangles.col(t++) << at, at + 1, at + columns;
      triangles.col(t++) << at + 1, at + columns + 1, at + columns;
    }
  }
  return triangles;
}

Target make_plate(std::uint64_t seed, const Vector3d& shift_mm) {
  constexpr double kSide_mm = 240;
  constexpr double kTilt_rad = 12 * std::numbers::pi / 180;
  constexpr int kPoints = 81;
  Random random(seed, kTargetStream);
  const double yaw = static_cast<double>(random.uniform(-1, 1)) * kTilt_rad * 0.7;
  const double pitch = static_cast<double>(random.uniform(-1, 1)) * kTilt_rad * 0.7;
  const Eigen::Matrix3d turn =
      (Eigen::AngleAxisd(yaw, Vector3d::UnitY()) * Eigen::AngleAxisd(pitch, Vector3d::UnitX()))
          .toRotationMatrix();
  Target plate;
  plate.form.centre_mm = shift_mm + Vector3d(0, 0, static_cast<double>(random.uniform(-15, 15)));
  plate.form.normal = turn.col(2);
  mesh::Vertices points_mm(3, kPoints * kPoints);
  for (int row = 0; row < kPoints; ++row) {
    for (int column = 0; column < kPoints; ++column) {
      const double u = kSide_mm * (static_cast<double>(column) / (kPoints - 1) - 0.5);
      const double v = kSide_mm * (0.5 - static_cast<double>(row) / (kPoints - 1));
      points_mm.col(row * kPoints + column) =
          (plate.form.centre_mm + u * turn.col(0) + v * turn.col(1)).cast<float>();
    }
  }
  const Eigen::Index count = points_mm.cols();
  plate.scene.add(points_mm, plate.form.normal.cast<float>().replicate(1, count),
                  Eigen::Matrix3Xf::Constant(3, count, kTargetAlbedo),
                  std::vector<Material>(static_cast<std::size_t>(count), Material::Cloth),
                  grid_triangles(kPoints, kPoints), Eigen::VectorXf::Ones(count));
  return plate;
}

/// Facets of 0.7 mm lie within 0.001 mm of the ball.
Target make_ball(std::uint64_t seed, const Vector3d& shift_mm) {
  constexpr double kRadius_mm = 60;
  constexpr int kAround = 513;
  constexpr int kAlong = 257;
  Random random(seed, kTargetStream);
  Target ball;
  const double x_mm = static_cast<double>(random.uniform(-10, 10));
  const double y_mm = static_cast<double>(random.uniform(-10, 10));
  const double z_mm = static_cast<double>(random.uniform(-10, 10));
  ball.form.centre_mm = shift_mm + Vector3d(x_mm, y_mm, z_mm);
  ball.form.radius_mm = kRadius_mm;
  mesh::Vertices points_mm(3, kAround * kAlong);
  Eigen::Matrix3Xf normals(3, points_mm.cols());
  for (int row = 0; row < kAlong; ++row) {
    const double polar = std::numbers::pi * row / (kAlong - 1);
    for (int column = 0; column < kAround; ++column) {
      const double turn = 2 * std::numbers::pi * column / (kAround - 1);
      const Vector3d out(std::sin(polar) * std::sin(turn), std::cos(polar), std::sin(polar) * std::cos(turn));
      normals.col(row * kAround + column) = out.cast<float>();
      points_mm.col(row * kAround + column) = (ball.form.centre_mm + kRadius_mm * out).cast<float>();
    }
  }
  const Eigen::Index count = points_mm.cols();
  ball.scene.add(points_mm, normals, Eigen::Matrix3Xf::Constant(3, count, kTargetAlbedo),
                 std::vector<Material>(static_cast<std::size_t>(count), Material::Cloth),
                 grid_triangles(kAround, kAlong), Eigen::VectorXf::Ones(count));
  return ball;
}

/// A camera, ready for rays.
struct CameraView {
  capture::Lens lens;
  bool colour = false;
  float gain = 1;
  Vector3f centre_mm{0, 0, 0};
  Eigen::Matrix3f rig_from_camera = Eigen::Matrix3f::Identity();
  LensRays rays;

  CameraView(const capture::RigCamera& camera, float given_gain)
      : lens(camera.lens), colour(camera.colour), gain(given_gain), rays(camera.lens) {
    const Eigen::Isometry3d pose = lens.camera_from_rig.inverse();
    centre_mm = pose.translation().cast<float>();
    rig_from_camera = pose.linear().cast<float>();
  }

  /// Pixels outside of which no point is seen; some more for what the lens bends. vertices_mm: rig frame
  Eigen::AlignedBox2i box_px(const mesh::Vertices& vertices_mm) const {
    constexpr float kMargin_px = 12;
    const Eigen::Matrix3f axes = rig_from_camera.transpose();
    Eigen::AlignedBox2f box;
    for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
      const Vector3f seen = axes * (vertices_mm.col(v) - centre_mm);
      if (seen.z() > 0) {
        box.extend(Vector2f(seen.head<2>() / seen.z()));
      }
    }
    const auto to_px = [&](const Vector2f& at, float margin_px) {
      const Vector2f px(static_cast<float>(lens.fx_px) * at.x() + static_cast<float>(lens.cx_px) + margin_px,
                        static_cast<float>(lens.fy_px) * at.y() + static_cast<float>(lens.cy_px) + margin_px);
      return Eigen::Vector2i(
          px.cwiseMax(-1.0F)
              .cwiseMin(Vector2f(static_cast<float>(lens.width_px), static_cast<float>(lens.height_px)))
              .cast<int>());
    };
    return {to_px(box.min(), -kMargin_px), to_px(box.max(), kMargin_px)};
  }
};

/// A projector's light, blurred by its optics. [height_px][width_px], white is 1
std::vector<float> blurred_light(const capture::GreyImage& image, float gamma, float sigma_px) {
  std::vector<float> light_of(256);
  for (std::size_t value = 0; value < light_of.size(); ++value) {
    light_of[value] = std::pow(static_cast<float>(value) / 255, gamma);
  }
  std::vector<float> light(image.values.size());
  std::transform(image.values.begin(), image.values.end(), light.begin(),
                 [&](std::uint8_t value) { return light_of[value]; });
  if (!(sigma_px > 0.05F)) {
    return light;
  }
  const int reach = static_cast<int>(std::ceil(3.5F * sigma_px));
  std::vector<float> kernel;
  float sum = 0;
  for (int k = -reach; k <= reach; ++k) {
    const float at = static_cast<float>(k) / sigma_px;
    kernel.push_back(std::exp(-0.5F * at * at));
    sum += kernel.back();
  }
  std::transform(kernel.begin(), kernel.end(), kernel.begin(), [&](float part) { return part / sum; });
  const auto width = static_cast<std::size_t>(image.width_px);
  std::vector<float> across(light.size(), 0.0F);
  const auto blur_rows = [&](int y) {
    const float* from = &light[static_cast<std::size_t>(y) * width];
    float* to = &across[static_cast<std::size_t>(y) * width];
    for (int x = 0; x < image.width_px; ++x) {
      const bool inside = x >= reach && x + reach < image.width_px;
      for (int k = -reach; k <= reach; ++k) {
        to[x] += kernel[static_cast<std::size_t>(k + reach)] *
                 from[inside ? x + k : std::clamp(x + k, 0, image.width_px - 1)];
      }
    }
  };
  const auto blur_columns = [&](int y) {
    float* to = &light[static_cast<std::size_t>(y) * width];
    std::fill_n(to, width, 0.0F);
    for (int k = -reach; k <= reach; ++k) {
      const float part_of_row = kernel[static_cast<std::size_t>(k + reach)];
      const float* from =
          &across[static_cast<std::size_t>(std::clamp(y + k, 0, image.height_px - 1)) * width];
      for (std::size_t x = 0; x < width; ++x) {
        to[x] += part_of_row * from[x];
      }
    }
  };
  render::for_each_row(image.height_px, blur_rows);
  render::for_each_row(image.height_px, blur_columns);
  return light;
}

/// A projector and what it shows, or a lamp.
struct ProjectorLight {
  const capture::Lens* lens = nullptr;  ///< null: a lamp, which shines all round
  float strength = 1;
  Vector3f centre_mm{0, 0, 0};
  double reference_mm = 1;   ///< depth at which a surface that faces it gets its full light
  std::vector<float> light;  ///< [height_px][width_px]; empty: white everywhere

  /// What a surface at a point would get, were it turned to the projector and in nobody's shadow: a flat
  /// field on any plane across the axis, which thins with the square of the depth.
  float at(const Vector3d& point_mm) const {
    if (lens == nullptr) {
      const double thinning = reference_mm / (centre_mm.cast<double>() - point_mm).norm();
      return strength * static_cast<float>(thinning * thinning);
    }
    const Vector3d seen = lens->camera_from_rig * point_mm;
    const auto pixel = lens->project(point_mm);
    if (!pixel) {
      return 0;
    }
    const double x = pixel->x();
    const double y = pixel->y();
    if (!(x >= 0 && y >= 0 && x <= lens->width_px - 1 && y <= lens->height_px - 1)) {
      return 0;
    }
    const double thinning = reference_mm / seen.z();
    // A plane across the axis sees a ray under its angle to the axis.
    const double flat = seen.norm() / seen.z();
    float value = 1;
    if (!light.empty()) {
      const int left = std::min(static_cast<int>(x), lens->width_px - 2);
      const int top = std::min(static_cast<int>(y), lens->height_px - 2);
      const auto u = static_cast<float>(x - left);
      const auto v = static_cast<float>(y - top);
      const auto width = static_cast<std::size_t>(lens->width_px);
      const float* corner = &light[static_cast<std::size_t>(top) * width + static_cast<std::size_t>(left)];
      value = (1 - v) * ((1 - u) * corner[0] + u * corner[1]) +
              v * ((1 - u) * corner[width] + u * corner[width + 1]);
    }
    return value * static_cast<float>(thinning * thinning * flat);
  }
};

/// What is in front of the cameras at one moment.
struct Moment {
  Scene scene;
  render::Raycaster caster;

  explicit Moment(Scene given)
      : scene(std::move(given)),
        caster(scene.vertices_mm, scene.triangles, render::Raycaster::Build::Quick) {}
};

}  // namespace

struct VirtualBooth::Impl {
  VirtualBoothConfig config;
  capture::Rig rig;
  std::unique_ptr<PlacedActor> placed;  ///< the actor's
  std::optional<BoothTarget> target;
  std::shared_ptr<const Moment> still;  ///< of a target or an actor that holds its pose
  Eigen::VectorXf skin;
  std::array<float, 9> room{};  ///< light of the room in the basis of [MD19 eq. 1], rig frame
  std::vector<CameraView> cameras;

  Impl(const face::FaceModel* model, const VirtualBoothConfig& given) : config(given) {
    check(model, config);
    rig = make_booth_rig(config.seed, config.resolution);
    rig.lights = config.lights;
    for (std::size_t k = 0; k < room.size(); ++k) {
      // From above and in front, and a little from everywhere.
      room[k] = static_cast<float>(config.ambient) *
                (0.8F * distant_light_sh(Vector3f(0, 0.6F, 0.8F))[k] + (k == 0 ? 0.4F : 0));
    }
    if (config.scene == BoothScene::Actor) {
      const std::uint64_t seed = config.actor_seed.value_or(config.seed);
      PerformanceConfig performance{.seed = seed, .duration_s = kPerformance_s, .start_s = config.start_s};
      if (config.curves) {
        performance.curves = config.curves;
        performance.duration_s = std::max(0.0, config.curves->duration_s() - config.start_s);
      }
      placed = std::make_unique<PlacedActor>(
          *model, ActorTraits{.seed = seed, .outside_span_mm = config.outside_span_mm}, performance);
      placed->put(Eigen::Matrix3f::Identity(), Vector3f::Zero(), static_cast<float>(config.head_motion));
      skin = placed->actor().face_skin();
    } else {
      Target made = config.scene == BoothScene::Plane ? make_plate(config.seed, config.target_shift_mm)
                                                      : make_ball(config.seed, config.target_shift_mm);
      target = made.form;
      skin = Eigen::VectorXf::Ones(made.scene.vertices_mm.cols());
      still = std::make_shared<const Moment>(std::move(made.scene));
    }
    const std::vector<float> gains = find_gains();
    for (std::size_t camera = 0; camera < rig.cameras.size(); ++camera) {
      cameras.emplace_back(rig.cameras[camera], gains[camera]);
    }
    if (placed && config.pose_s) {
      still = moment(*config.pose_s);
    }
  }

  std::vector<float> light_of(const capture::GreyImage& image) const {
    return blurred_light(image, config.patterns.gamma, static_cast<float>(config.projector_blur_px));
  }

  bool moves() const { return !still && config.exposure_ms > 0; }

  double start_s(std::uint64_t slot) const { return static_cast<double>(slot) / config.slots_per_second; }

  std::shared_ptr<const Moment> moment(double time_s) const {
    if (still) {
      return still;
    }
    Scene scene;
    placed->build_scene(time_s, scene);
    return std::make_shared<const Moment>(std::move(scene));
  }

  /// The projectors' light; white without `shown`.
  /// pictures: of each projector, where they show pictures of their own
  std::vector<ProjectorLight> light(const std::optional<capture::Shown>& shown,
                                    const std::vector<capture::GreyImage>& pictures = {}) const {
    std::vector<ProjectorLight> lights;
    for (std::size_t p = 0; p < rig.projectors.size(); ++p) {
      const bool own_picture = shown && shown->kind == capture::Shown::Kind::Picture;
      if ((shown && shown->kind == capture::Shown::Kind::Dark) ||
          (own_picture && pictures[p].values.empty())) {
        continue;
      }
      ProjectorLight made;
      made.lens = &rig.projectors[p].lens;
      made.centre_mm = made.lens->centre_mm().cast<float>();
      made.reference_mm = made.lens->camera_from_rig.translation().z();  // the depth of the rig's origin
      if (own_picture) {
        made.light = light_of(pictures[p]);
      } else if (shown) {
        capture::PatternConfig patterns = config.patterns;
        patterns.width_px = made.lens->width_px;
        patterns.height_px = made.lens->height_px;
        made.light = light_of(capture::draw_pattern(patterns, *shown, p));
      }
      lights.push_back(std::move(made));
    }
    return lights;
  }

  /// Light that a point gets, the same for all colours: the room's [MD19 eq. 1], and of each
  /// projector that sees it, Lambert's cosine.
  /// mirrored: where not null, what skin mirrors of it to eye_mm is added there
  float irradiance(const Moment& moment, const std::vector<ProjectorLight>& lights, const Vector3f& at_mm,
                   const Vector3f& normal, float open, const Vector3f& eye_mm = Vector3f::Zero(),
                   float* mirrored_light = nullptr) const {
    const auto basis =
        maths::harmonics(normal.x(), normal.y(), normal.z());  // the rig's axes are the lighting's
    float ambient = 0;
    for (std::size_t k = 0; k < room.size(); ++k) {
      ambient += room[k] * basis[k];
    }
    float sum = open * std::max(0.0F, ambient);
    const Vector3f from_mm = at_mm + kLift_mm * normal;
    for (const ProjectorLight& projector : lights) {
      const Vector3f to_projector = (projector.centre_mm - at_mm).normalized();
      const float cosine = normal.dot(to_projector);
      if (!(cosine > 0)) {
        continue;
      }
      const float light = cosine * projector.at(at_mm.cast<double>());
      if (light > 0 && !moment.caster.occluded(from_mm, projector.centre_mm, 0)) {
        sum += light;
        if (mirrored_light != nullptr) {
          const Gloss gloss{static_cast<float>(config.gloss), static_cast<float>(config.gloss_roughness)};
          *mirrored_light +=
              light / cosine * mirrored(normal, to_projector, (eye_mm - at_mm).normalized(), gloss);
        }
      }
    }
    return sum;
  }

  /// A camera's gain so that its brightest skin under white comes out as kBrightSkin, give or take 4 %: no
  /// two cameras are set alike.
  std::vector<float> find_gains() const {
    const auto first = moment(0);
    const std::vector<ProjectorLight> white = light(std::nullopt);
    const Eigen::Index count = skin.size();
    Eigen::Matrix3Xf shown = Eigen::Matrix3Xf::Zero(3, count);
    render::for_each_row(static_cast<int>(count), [&](int v) {
      if (skin[v] > 0.9F) {
        shown.col(v) =
            irradiance(*first, white, first->scene.vertices_mm.col(v), first->scene.normals.col(v), 1) *
            first->scene.albedo.col(v);
      }
    });
    Random random(config.seed, kCameraStream);
    std::vector<float> gains;
    for (const capture::RigCamera& camera : rig.cameras) {
      const Vector3f centre_mm = camera.lens.centre_mm().cast<float>();
      std::vector<float> values;
      for (Eigen::Index v = 0; v < count; ++v) {
        const Vector3f to_camera = centre_mm - first->scene.vertices_mm.col(v);
        if (skin[v] > 0.9F && first->scene.normals.col(v).dot(to_camera) > 0.3F * to_camera.norm()) {
          values.push_back(camera.colour ? shown.col(v).maxCoeff() : kMonochrome.dot(shown.col(v)));
        }
      }
      if (values.empty()) {
        throw Error(
            ErrorKind::UnreadableInput,
            fmt::format("the face model marks no refinable skin that camera '{}' could see", camera.name));
      }
      const float brightest =
          maths::nth_of(values, static_cast<std::size_t>(0.97 * static_cast<double>(values.size())));
      gains.push_back(random.uniform(0.96F, 1.04F) * kBrightSkin / brightest);
    }
    return gains;
  }

  const CameraView& view(std::size_t camera) const {
    if (camera >= cameras.size()) {
      throw Error(ErrorKind::Usage, fmt::format("the virtual booth has {} cameras; there is no camera {}",
                                                cameras.size(), camera));
    }
    return cameras[camera];
  }
};

struct BoothSlot::Impl {
  std::shared_ptr<const VirtualBooth::Impl> booth;
  std::uint64_t number = 0;
  capture::Shown shown;
  std::vector<capture::GreyImage> pictures;  ///< that are shown in place of patterns
  std::vector<std::size_t> lamps;            ///< of the rig's lights, that shine
  // Made when they are first needed.
  std::vector<std::shared_ptr<const Moment>> exposure;  ///< [samples]
  std::shared_ptr<const Moment> middle_moment;
  std::optional<std::vector<ProjectorLight>> projectors;

  double at_s(double part_of_exposure) const {
    return booth->start_s(number) + 1e-3 * booth->config.exposure_ms * part_of_exposure;
  }

  const Moment& middle() {
    if (!middle_moment) {
      middle_moment = booth->moment(at_s(0.5));
    }
    return *middle_moment;
  }

  const std::vector<std::shared_ptr<const Moment>>& moments() {
    const auto samples = static_cast<std::size_t>(booth->config.samples);
    if (exposure.empty()) {
      for (std::size_t k = 0; k < samples; ++k) {
        if (!booth->moves() || 2 * k + 1 == samples) {
          middle();
          exposure.push_back(middle_moment);
        } else {
          exposure.push_back(
              booth->moment(at_s((static_cast<double>(k) + 0.5) / static_cast<double>(samples))));
        }
      }
    }
    return exposure;
  }

  const std::vector<ProjectorLight>& lights() {
    if (!projectors) {
      projectors = booth->light(shown, pictures);
      for (const std::size_t lamp : lamps) {
        ProjectorLight& light = projectors->emplace_back();
        light.centre_mm = booth->rig.lights[lamp].position_mm.cast<float>();
        light.reference_mm = 1000;
        light.strength = static_cast<float>(booth->rig.lights[lamp].strength);
      }
    }
    return *projectors;
  }

  /// Colour of what a ray meets, linear RGB; nothing where it meets nothing.
  std::optional<Vector3f> shade(const Moment& moment, const CameraView& view, const Vector3f& direction) {
    const auto hit = moment.caster.first_hit(view.centre_mm, view.rig_from_camera * direction.normalized());
    if (hit.triangle < 0) {
      return std::nullopt;
    }
    const auto at = [&](const Eigen::Matrix3Xf& field) {
      return render::interpolate(moment.scene.triangles, hit.triangle, hit.barycentric, field);
    };
    const auto corner = moment.scene.triangles(0, hit.triangle);
    float open = moment.scene.openness[corner];
    if (std::isnan(open)) {
      open = openness_of(moment.scene.materials[static_cast<std::size_t>(corner)]);
    }
    const bool shines =
        booth->config.gloss > 0 && moment.scene.materials[static_cast<std::size_t>(corner)] == Material::Skin;
    float gloss = 0;
    const float light = booth->irradiance(moment, *projectors, at(moment.scene.vertices_mm),
                                          at(moment.scene.normals).normalized(), open, view.centre_mm,
                                          shines ? &gloss : nullptr);
    return light * at(moment.scene.albedo) + Vector3f::Constant(gloss);
  }

  /// Linear light on the sensor, [1 or 3][pixels].
  Eigen::MatrixXf expose(const CameraView& view) {
    const auto& each_moment = moments();
    lights();
    const auto offsets_px = render::sample_offsets_px(booth->config.samples);
    Eigen::AlignedBox2i seen = view.box_px(each_moment.front()->scene.vertices_mm);
    seen.extend(view.box_px(each_moment.back()->scene.vertices_mm));
    const int width = view.lens.width_px;
    Eigen::MatrixXf image(view.colour ? 3 : 1, static_cast<Eigen::Index>(width) * view.lens.height_px);
    render::for_each_row(view.lens.height_px, [&](int y) {
      for (int x = 0; x < width; ++x) {
        Vector3f sum = Vector3f::Zero();
        float missed = seen.contains(Eigen::Vector2i(x, y)) ? 0.0F : 1.0F;
        if (missed == 0) {
          const float share = 1 / static_cast<float>(offsets_px.size());
          for (std::size_t k = 0; k < offsets_px.size(); ++k) {
            if (const auto colour = shade(*each_moment[k], view, view.rays.direction(x, y, offsets_px[k]))) {
              sum += share * view.gain * *colour;
            } else {
              missed += share;
            }
          }
        }
        // Natural vignetting: the fourth power of the cosine to the axis.
        const float cosine2 = 1 / view.rays.direction(x, y, {0, 0}).squaredNorm();
        sum = cosine2 * cosine2 * (sum.array() + missed * kBackdrop);
        const Eigen::Index pixel = static_cast<Eigen::Index>(y) * width + x;
        if (view.colour) {
          image.col(pixel).head<3>() = sum;
        } else {
          image(0, pixel) = kMonochrome.dot(sum);
        }
      }
    });
    return image;
  }
};

BoothSlot::BoothSlot(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
BoothSlot::~BoothSlot() = default;
BoothSlot::BoothSlot(BoothSlot&& other) noexcept = default;
BoothSlot& BoothSlot::operator=(BoothSlot&& other) noexcept = default;

std::uint64_t BoothSlot::number() const {
  return impl_->number;
}

const capture::Shown& BoothSlot::shown() const {
  return impl_->shown;
}

std::int64_t BoothSlot::trigger_ns() const {
  return std::llround(1e9 * impl_->booth->start_s(impl_->number));
}

Frame BoothSlot::frame(std::size_t camera) const {
  const CameraView& view = impl_->booth->view(camera);
  const Eigen::MatrixXf light = impl_->expose(view);
  const Sensor sensor{kFullWell_e, kReadNoise_e, impl_->booth->config.sensor_noise};
  const std::uint64_t noise_seed = mix(mix(impl_->booth->config.seed) + kMaxCameras * impl_->number + camera);
  const std::vector<std::uint8_t> bytes =
      develop(light, view.lens.width_px, view.lens.height_px, sensor, noise_seed);
  const auto pixels = static_cast<std::size_t>(light.cols());
  auto rgba = std::make_shared<std::uint8_t[]>(4 * pixels);
  const std::size_t channels = view.colour ? 3 : 1;
  std::uint8_t* to = rgba.get();
  for (std::size_t pixel = 0; pixel < pixels; ++pixel, to += 4) {
    for (std::size_t c = 0; c < 3; ++c) {
      to[c] = bytes[pixel * channels + (view.colour ? c : 0)];
    }
    to[3] = 255;
  }
  Frame frame;
  frame.sequence = impl_->number;
  frame.timestamp_ns = trigger_ns();
  frame.media_time_ns = frame.timestamp_ns;
  frame.width_px = view.lens.width_px;
  frame.height_px = view.lens.height_px;
  frame.stride_bytes = 4 * static_cast<std::size_t>(frame.width_px);
  frame.pixels = std::move(rgba);
  return frame;
}

FrameSet BoothSlot::frame_set() const {
  FrameSet set;
  set.slot = impl_->number;
  set.trigger_ns = trigger_ns();
  std::vector<std::string> names;
  for (std::size_t camera = 0; camera < impl_->booth->cameras.size(); ++camera) {
    set.frames.push_back(frame(camera));
    names.push_back(impl_->booth->rig.cameras[camera].name);
  }
  set.camera_names = std::make_shared<const std::vector<std::string>>(std::move(names));
  return set;
}

DepthTruth BoothSlot::depth(std::size_t camera, std::optional<std::size_t> other) const {
  const CameraView& view = impl_->booth->view(camera);
  const CameraView* partner = other ? &impl_->booth->view(*other) : nullptr;
  const Moment& moment = impl_->middle();
  const Eigen::VectorXf& skin = impl_->booth->skin;
  DepthTruth truth;
  truth.width_px = view.lens.width_px;
  truth.height_px = view.lens.height_px;
  const auto count = static_cast<std::size_t>(truth.width_px) * static_cast<std::size_t>(truth.height_px);
  truth.depth_mm.assign(count, 0);
  truth.skin.assign(count, 0);
  truth.shared.assign(count, 0);
  render::for_each_row(truth.height_px, [&](int y) {
    for (int x = 0; x < truth.width_px; ++x) {
      const Vector3f direction = view.rig_from_camera * view.rays.direction(x, y, {0, 0});
      const auto hit = moment.caster.first_hit(view.centre_mm, direction.normalized());
      if (hit.triangle < 0) {
        continue;
      }
      const auto pixel = static_cast<std::size_t>(y) * static_cast<std::size_t>(truth.width_px) +
                         static_cast<std::size_t>(x);
      const Vector3f at_mm = render::interpolate(moment.scene.triangles, hit.triangle, hit.barycentric,
                                                 moment.scene.vertices_mm);
      truth.depth_mm[pixel] = static_cast<float>((view.lens.camera_from_rig * at_mm.cast<double>()).z());
      const auto corners = moment.scene.triangles.col(hit.triangle);
      if (corners.maxCoeff() < skin.size()) {
        const Vector2f& weight = hit.barycentric;
        truth.skin[pixel] = (1 - weight.x() - weight.y()) * skin[corners[0]] + weight.x() * skin[corners[1]] +
                                        weight.y() * skin[corners[2]] >
                                    0.5F
                                ? 1
                                : 0;
      }
      if (partner != nullptr) {
        const auto seen = partner->lens.project(at_mm.cast<double>());
        const bool inside = seen && seen->x() >= 0 && seen->y() >= 0 &&
                            seen->x() <= partner->lens.width_px - 1 &&
                            seen->y() <= partner->lens.height_px - 1;
        const Vector3f normal =
            render::interpolate(moment.scene.triangles, hit.triangle, hit.barycentric, moment.scene.normals);
        truth.shared[pixel] = inside && normal.dot(partner->centre_mm - at_mm) > 0 &&
                                      !moment.caster.occluded(at_mm, partner->centre_mm, kLift_mm)
                                  ? 1
                                  : 0;
      }
    }
  });
  return truth;
}

TruthMesh BoothSlot::surface() const {
  const Scene& scene = impl_->middle().scene;
  if (impl_->booth->placed) {
    return impl_->booth->placed->head_of(scene);
  }
  return {scene.vertices_mm, scene.normals, scene.albedo, scene.triangles};
}

VirtualBooth::VirtualBooth(const face::FaceModel* model, const VirtualBoothConfig& config)
    : impl_(std::make_shared<const Impl>(model, config)) {}

const VirtualBoothConfig& VirtualBooth::config() const {
  return impl_->config;
}

const capture::Rig& VirtualBooth::rig() const {
  return impl_->rig;
}

const Eigen::VectorXf& VirtualBooth::skin() const {
  return impl_->skin;
}

std::optional<BoothTarget> VirtualBooth::target() const {
  return impl_->target;
}

BoothSlot VirtualBooth::slot(std::uint64_t number) const {
  return slot(number, capture::standard_program());
}

BoothSlot VirtualBooth::slot(std::uint64_t number, const capture::Shown& shown) const {
  auto made = std::make_unique<BoothSlot::Impl>();
  made->booth = impl_;
  made->number = number;
  made->shown = shown;
  return BoothSlot(std::move(made));
}

BoothSlot VirtualBooth::slot(std::uint64_t number, std::vector<capture::GreyImage> pictures) const {
  const std::vector<capture::RigProjector>& projectors = impl_->rig.projectors;
  if (pictures.size() != projectors.size()) {
    throw Error(ErrorKind::Usage, fmt::format("virtual booth: {} pictures for {} projectors", pictures.size(),
                                              projectors.size()));
  }
  for (std::size_t p = 0; p < pictures.size(); ++p) {
    const capture::GreyImage& picture = pictures[p];
    const capture::Lens& lens = projectors[p].lens;
    if (!picture.values.empty() &&
        (picture.width_px != lens.width_px || picture.height_px != lens.height_px)) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("virtual booth: a picture of {}x{} px for projector '{}' of {}x{}", picture.width_px,
                      picture.height_px, projectors[p].name, lens.width_px, lens.height_px));
    }
  }
  auto made = std::make_unique<BoothSlot::Impl>();
  made->booth = impl_;
  made->number = number;
  made->shown = {capture::Shown::Kind::Picture, number};
  made->pictures = std::move(pictures);
  return BoothSlot(std::move(made));
}

BoothSlot VirtualBooth::slot(std::uint64_t number, const capture::SlotProgram& program) const {
  const capture::SlotLight& light = capture::light_of_slot(program, number);
  if (light.kind != capture::SlotLight::Kind::Lit) {
    return slot(number, capture::shown_in_slot(program, number));
  }
  const capture::Rig& rig = impl_->rig;
  std::vector<capture::GreyImage> pictures(rig.projectors.size());
  std::vector<std::size_t> lamps;
  for (const std::string& name : light.lights) {
    const auto projector = std::find_if(rig.projectors.begin(), rig.projectors.end(),
                                        [&](const capture::RigProjector& one) { return one.name == name; });
    const auto lamp = std::find_if(rig.lights.begin(), rig.lights.end(),
                                   [&](const capture::RigLight& one) { return one.name == name; });
    if (projector != rig.projectors.end()) {
      const capture::Lens& lens = projector->lens;
      const auto pixels = static_cast<std::size_t>(lens.width_px) * static_cast<std::size_t>(lens.height_px);
      pictures[static_cast<std::size_t>(projector - rig.projectors.begin())] = {
          lens.width_px, lens.height_px, std::vector<std::uint8_t>(pixels, 255)};
    } else if (lamp != rig.lights.end()) {
      lamps.push_back(static_cast<std::size_t>(lamp - rig.lights.begin()));
    } else {
      throw Error(ErrorKind::Usage, fmt::format("virtual booth: there is no projector or lamp '{}'", name));
    }
  }
  BoothSlot made = slot(number, std::move(pictures));
  made.impl_->lamps = std::move(lamps);
  return made;
}

}  // namespace facet::simulation
