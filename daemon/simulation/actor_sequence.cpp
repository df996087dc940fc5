#include "simulation/actor_sequence.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "facet/error.hpp"
#include "maths/statistics.hpp"
#include "simulation/lens_rays.hpp"
#include "simulation/look_picture.hpp"
#include "simulation/look_shading.hpp"
#include "simulation/optics.hpp"
#include "simulation/placed_actor.hpp"
#include "simulation/random.hpp"
#include "simulation/sensor.hpp"

namespace facet::simulation {
namespace {

using Eigen::Isometry3f;
using Eigen::Vector3f;

constexpr float kDegree = std::numbers::pi_v<float> / 180;
constexpr float kSkinExposure = 0.72F;  // linear value of the brightest skin

/// Head axes (x left, y up, z out) in camera axes (x right, y down, z forward) for a head that faces the
/// camera.
Eigen::Matrix3f camera_from_head_axes() {
  return Vector3f(1, -1, -1).asDiagonal();
}

/// A room out of focus: soft shapes over a gradient, linear RGB, [3][pixel_count].
Eigen::Matrix3Xf make_background(const ActorSequenceConfig& config) {
  Random random(config.seed, 81);
  const Noise shapes(config.seed, 82);
  const Vector3f wall =
      random.uniform(0.08F, 0.3F) *
      Vector3f(random.uniform(0.8F, 1.2F), random.uniform(0.9F, 1.1F), random.uniform(0.75F, 1.25F));
  struct Blob {
    float x, y, radius;
    Vector3f colour;
  };
  std::vector<Blob> blobs;
  blobs.reserve(6);
  for (int k = 0; k < 6; ++k) {
    blobs.push_back(
        {random.uniform(),
         random.uniform(),
         random.uniform(0.08F, 0.3F),
         {random.uniform(0.02F, 0.5F), random.uniform(0.02F, 0.5F), random.uniform(0.02F, 0.5F)}});
  }
  Eigen::Matrix3Xf background(3, static_cast<Eigen::Index>(config.width_px) * config.height_px);
  const auto width = static_cast<float>(config.width_px);
  const auto height = static_cast<float>(config.height_px);
  render::for_each_row(config.height_px, [&](int y) {
    for (int x = 0; x < config.width_px; ++x) {
      const float u = static_cast<float>(x) / height;
      const float v = static_cast<float>(y) / height;
      Vector3f colour =
          wall * (1.15F - 0.4F * v) * (1 + 0.15F * shapes.fractal({2.2F * u, 2.2F * v, 0.5F}, 2));
      for (const Blob& blob : blobs) {
        const float distance = std::hypot(u - blob.x * width / height, v - blob.y) / blob.radius;
        colour += 0.6F * smooth_step(1.5F, 0.4F, distance) * (blob.colour - colour);
      }
      background.col(static_cast<Eigen::Index>(y) * config.width_px + x) = colour.cwiseMax(0.0F);
    }
  });
  return background;
}

}  // namespace

struct ActorSequence::Impl {
  ActorSequenceConfig config;
  std::string model_name;
  PlacedActor placed;
  CameraIntrinsics camera;
  Lighting lighting;
  /// Of each camera, the first one included.
  struct View {
    CameraIntrinsics camera;
    Eigen::Isometry3f view_from_first = Eigen::Isometry3f::Identity();
    Vector3f gain{1, 1, 1};
    Eigen::Matrix3Xf background;
  };
  std::vector<View> views;
  /// Of each camera.
  struct Equipment {
    Webcam webcam;
    std::unique_ptr<LensRays> rays;          ///< of a webcam's lens or shutter; null: a pinhole's one moment
    std::unique_ptr<AutoControls> controls;  ///< null: none
  };
  std::vector<Equipment> equipment;
  capture::Rig rig;

  Impl(const face::FaceModel& model, const ActorSequenceConfig& given)
      : config(given),
        model_name(model.name),
        placed(model,
               {.seed = given.person.value_or(given.seed),
                .glasses = given.glasses,
                .outside_span_mm = given.outside_span_mm,
                .look = given.look},
               {.seed = given.seed,
                .duration_s = static_cast<double>(given.frame_count) / given.rate_hz + (given.curves ? 0 : 1),
                .start_s = given.start_s,
                .calm_turn = given.calm_turn,
                .curves = given.curves}) {}

  /// The light of a frame, and of a strobe or a burst the lamp that fires.
  Lighting light_of(int index, int& lamp) const {
    lamp = -1;
    const int since = index - static_cast<int>(std::lround((kCalmTurn_s - config.start_s) * config.rate_hz));
    if (config.burst != Burst::None && since >= 0) {
      return burst_light(config.burst, lighting, placed.resting_pivot_mm(), since, lamp);
    }
    if (lighting.kind == LightKind::Strobe) {
      lamp = index % static_cast<int>(lighting.area_lights.size());
    }
    return lighting_of_frame(lighting, index);
  }

  double time_s(int index) const { return static_cast<double>(index) / config.rate_hz; }

  void place_camera() {
    Random random(config.seed, 83);
    const float field_rad = random.uniform(45, 60) * kDegree;
    const auto width = static_cast<float>(config.width_px);
    const auto height = static_cast<float>(config.height_px);
    const float focal_px = 0.5F * std::max(width, height) / std::tan(0.5F * field_rad);
    camera = {focal_px, focal_px, 0.5F * (width - 1), 0.5F * (height - 1), config.width_px, config.height_px};
    const Anatomy& face = placed.actor().anatomy();
    const float face_mm = (face.forehead - face.chin).norm();
    const float part = random.uniform(0.38F, 0.48F);  // of the picture's height that the face fills
    constexpr float kNearest_mm = 450;
    constexpr float kFarthest_mm = 700;
    const float distance_mm =
        std::clamp(focal_px * face_mm / (part * std::min(height, width)), kNearest_mm, kFarthest_mm);
    const Vector3f middle_mm(random.uniform(-25, 25), random.uniform(-10, 20), distance_mm);
    placed.put(camera_from_head_axes(), middle_mm);
    placed.turn_once(static_cast<float>(config.turn_deg) * kDegree, time_s(config.frame_count - 1));
  }

  /// Further cameras, by turns to the first one's right and left, at its distance from the head.
  void place_further_cameras() {
    views.push_back({camera, Eigen::Isometry3f::Identity(), Vector3f(1, 1, 1), make_background(config)});
    Random random(config.seed, 84);
    const Vector3f middle_mm = placed.resting_pivot_mm() + Vector3f(0, -60, -60);  // about between the cheeks
    for (int k = 1; k < config.camera_count; ++k) {
      const float side = k % 2 == 1 ? 1.0F : -1.0F;
      const int place = (k + 1) / 2;
      const auto steps = static_cast<float>(place);
      const float turn_rad =
          (side * steps * static_cast<float>(config.spread_deg) + random.uniform(-1, 1)) * kDegree;
      View view;
      view.camera = camera;
      view.camera.fx = view.camera.fy = camera.fx * random.uniform(0.96F, 1.04F);
      view.camera.cx += random.uniform(-8, 8);
      view.camera.cy += random.uniform(-8, 8);
      const Eigen::Matrix3f turned = (Eigen::AngleAxisf(random.uniform(-2, 2) * kDegree, Vector3f::UnitZ()) *
                                      Eigen::AngleAxisf(random.uniform(-3, 3) * kDegree, Vector3f::UnitX()) *
                                      Eigen::AngleAxisf(turn_rad, Vector3f::UnitY()))
                                         .toRotationMatrix();
      const Vector3f aim_mm = middle_mm + Vector3f(random.uniform(-12, 12), random.uniform(-12, 12), 0);
      view.view_from_first.linear() = turned;
      view.view_from_first.translation() = aim_mm - turned * middle_mm;
      const float exposure = random.uniform(0.75F, 1.05F);
      view.gain = exposure * Vector3f(random.uniform(0.94F, 1.06F), 1, random.uniform(0.94F, 1.06F));
      ActorSequenceConfig elsewhere = config;
      elsewhere.seed = mix(config.seed + static_cast<std::uint64_t>(k));
      view.background = make_background(elsewhere);
      views.push_back(std::move(view));
    }
    for (std::size_t k = 0; k < views.size(); ++k) {
      const View& view = views[k];
      capture::RigCamera made;
      made.name = k == 0 ? "video" : fmt::format("view-{}", k + 1);
      made.colour = true;
      made.lens.width_px = view.camera.width_px;
      made.lens.height_px = view.camera.height_px;
      made.lens.fx_px = static_cast<double>(view.camera.fx);
      made.lens.fy_px = static_cast<double>(view.camera.fy);
      made.lens.cx_px = static_cast<double>(view.camera.cx);
      made.lens.cy_px = static_cast<double>(view.camera.cy);
      // Orthonormal in double precision, too, as a rig file must be.
      const Eigen::Quaterniond turn(Eigen::Matrix3d(view.view_from_first.linear().cast<double>()));
      made.lens.camera_from_rig.linear() = turn.normalized().toRotationMatrix();
      made.lens.camera_from_rig.translation() = view.view_from_first.translation().cast<double>();
      rig.cameras.push_back(made);
    }
  }

  /// Gives each camera its webcam, and its lens in the rig the distortion.
  void equip() {
    const WebcamEffects& effects = config.webcam;
    for (std::size_t k = 0; k < views.size(); ++k) {
      Equipment& made = equipment.emplace_back();
      capture::Lens& lens = rig.cameras[k].lens;
      const std::uint64_t seed = config.seed + (k << 40U);
      made.webcam = draw_webcam(effects, seed, lens, config.rate_hz);
      lens.distortion = made.webcam.distortion;
      if (effects.distortion || made.webcam.span_s() > 0) {
        made.rays = std::make_unique<LensRays>(lens);
      }
      if (effects.exposure || effects.white_balance) {
        made.controls = std::make_unique<AutoControls>(
            effects, seed, config.rate_hz, [this, k](double time_s) { return meter(views[k], time_s); });
      }
    }
  }

  /// What a view's sensor gets, by a few rays over the picture.
  Metering meter(const View& view, double time_s) const {
    constexpr int kColumns = 32;
    constexpr int kRows = 18;
    Scene scene;
    placed.build_scene(time_s, scene);
    const render::Raycaster caster(scene.vertices_mm, scene.triangles, render::Raycaster::Build::Quick);
    const Isometry3f first_from_view = view.view_from_first.inverse();
    int unused_lamp = -1;
    const Eigen::Matrix3Xf colours = shade_vertices(
        scene, caster, light_of(static_cast<int>(std::lround(time_s * config.rate_hz)), unused_lamp),
        config.highlights, first_from_view.translation());
    Metering metering;
    int centre_count = 0;
    for (int row = 0; row < kRows; ++row) {
      for (int column = 0; column < kColumns; ++column) {
        const int x = (2 * column + 1) * config.width_px / (2 * kColumns);
        const int y = (2 * row + 1) * config.height_px / (2 * kRows);
        const Vector3f direction((static_cast<float>(x) - view.camera.cx) / view.camera.fx,
                                 (static_cast<float>(y) - view.camera.cy) / view.camera.fy, 1);
        const auto hit = caster.first_hit(first_from_view.translation(),
                                          first_from_view.linear() * direction.normalized());
        const Vector3f light =
            hit.triangle < 0
                ? Vector3f(view.background.col(static_cast<Eigen::Index>(y) * config.width_px + x))
                : render::interpolate(scene.triangles, hit.triangle, hit.barycentric, colours);
        metering.whole += light;
        if (std::abs(2 * column + 1 - kColumns) <= kColumns / 3 &&
            std::abs(2 * row + 1 - kRows) <= kRows / 2) {
          metering.centre += light;
          ++centre_count;
        }
      }
    }
    metering.whole = view.gain.cwiseProduct(metering.whole) / (kColumns * kRows);
    metering.centre = view.gain.cwiseProduct(metering.centre) / static_cast<float>(centre_count);
    return metering;
  }

  /// A camera's metering brightens dark skin by a part of what it lacks, no more.
  float skin_exposure() const {
    if (config.look.painted()) {
      return kSkinExposure;
    }
    constexpr float kFairSkin = 0.42F;
    const float skin = placed.actor().skin().y();
    return kSkinExposure * std::min(1.0F, std::pow(skin / kFairSkin, 0.45F));
  }

  /// Sets the light so that the face's brightest skin comes out as skin_exposure() in the first frame.
  void expose() {
    Scene scene;
    placed.build_scene(0, scene);
    const render::Raycaster caster(scene.vertices_mm, scene.triangles);
    const Eigen::Matrix3Xf colours = shade_vertices(scene, caster, lighting_of_frame(lighting, 0), false);
    const Eigen::VectorXf& skin = placed.actor().face_skin();
    std::vector<float> values;
    for (Eigen::Index v = 0; v < skin.size(); ++v) {
      if (skin[v] > 0.9F && colours.col(v).maxCoeff() > 0) {
        values.push_back(colours.col(v).maxCoeff());
      }
    }
    if (values.empty()) {
      throw Error(ErrorKind::UnreadableInput,
                  "the face model marks no refinable skin that the camera could see");
    }
    const float brightest =
        maths::nth_of(values, static_cast<std::size_t>(0.97 * static_cast<double>(values.size())));
    const float exposure = skin_exposure() / brightest;
    for (float& coefficient : lighting.spherical_harmonics) {
      coefficient *= exposure;
    }
    for (float& strength : lighting.main_strengths) {
      strength *= exposure;
    }
    for (AreaLight& light : lighting.area_lights) {
      light.irradiance *= exposure;
    }
  }

  /// The linear picture of a painted actor. [3][pixels]
  /// scene, caster: in the first camera's frame.
  Eigen::Matrix3Xf painted_picture(const View& view, const Scene& scene, const render::Raycaster& caster,
                                   const Lighting& now) const {
    const Vector3f eye_mm = view.view_from_first.inverse().translation();
    const Eigen::Matrix3Xf colours = shade_vertices(scene, caster, now, config.highlights, eye_mm);
    if (&view == &views.front()) {
      return expose_picture(view, scene.vertices_mm, scene.triangles, caster, colours);
    }
    const mesh::Vertices vertices_mm = view.view_from_first * scene.vertices_mm;
    const render::Raycaster from_there(vertices_mm, scene.triangles);
    return view.gain.asDiagonal() * expose_picture(view, vertices_mm, scene.triangles, from_there, colours);
  }

  /// The linear picture of an actor that is not painted. [3][pixels]
  /// scene, strands, caster: at the frame's time, in the first camera's frame.
  Eigen::Matrix3Xf look_picture(std::size_t k, const Scene& scene, const render::StrandCaster& strands,
                                const render::Raycaster& caster, const Lighting& now, double time_s,
                                std::uint64_t noise_seed) const {
    const VirtualActor& actor = placed.actor();
    const Vector3f eye_mm = views[k].view_from_first.inverse().translation();
    const LookScene lit{scene, caster, actor.hair(), strands, actor.scattering(), actor.skin_maps().oil};
    const auto picture_of = [&](const render::Raycaster& surfaces, const render::StrandCaster& hairs) {
      const PictureRays rays(optics_of(k, noise_seed), surfaces, hairs, ray_count(k));
      const Eigen::Matrix3Xf colours = shade_look(
          lit, now, config.look, rays.seen_vertices(scene.triangles, scene.vertices_mm.cols()), eye_mm);
      const Eigen::Matrix3Xf strand_colours =
          shade_strands(lit, now, rays.seen_strands(hairs.strands(), actor.hair().first), eye_mm);
      return rays.picture(scene.triangles, colours, hairs.strands(), strand_colours, views[k].background);
    };
    if (k == 0 && !equipment[k].rays) {
      return picture_of(caster, strands);
    }
    const Moments moments = moments_of(k, scene, strands.strands().points, time_s);
    const render::Raycaster surfaces(moments.surfaces_mm, scene.triangles);
    const render::StrandCaster hairs({moments.strands.front(), strands.strands().segments},
                                     {moments.strands.begin() + 1, moments.strands.end()});
    return views[k].gain.asDiagonal() * picture_of(surfaces, hairs);
  }

  /// How a camera looks at a frame.
  Optics optics_of(std::size_t k, std::uint64_t noise_seed) const {
    const Equipment& made = equipment[k];
    return made.rays ? webcam_optics(rig.cameras[k].lens, *made.rays, made.webcam, mix(noise_seed))
                     : pinhole_optics(views[k].camera);
  }

  /// Of a pixel.
  int ray_count(std::size_t k) const {
    constexpr int kBlurRays = 8;  // at least, or a moving edge has steps
    return equipment[k].webcam.exposure_s > 0 ? std::max(kBlurRays, config.rays_per_pixel)
                                              : config.rays_per_pixel;
  }

  /// The linear picture: the scene over the background, averaged over the rays of each pixel. [3][pixels]
  /// vertices_mm, caster: in the view's frame.
  Eigen::Matrix3Xf expose_picture(const View& view, const mesh::Vertices& vertices_mm,
                                  const mesh::Triangles& triangles, const render::Raycaster& caster,
                                  const Eigen::Matrix3Xf& colours) const {
    const CameraIntrinsics& lens = view.camera;
    Eigen::Matrix3Xf image = view.background;
    // Rays only where the scene can be.
    Eigen::Array2f low(static_cast<float>(config.width_px), static_cast<float>(config.height_px));
    Eigen::Array2f high(0, 0);
    for (Eigen::Index v = 0; v < vertices_mm.cols(); ++v) {
      const Vector3f at = vertices_mm.col(v);
      constexpr float kNear_mm = 20;
      if (at.z() > kNear_mm) {
        const Eigen::Array2f px(lens.fx * at.x() / at.z() + lens.cx, lens.fy * at.y() / at.z() + lens.cy);
        low = low.min(px);
        high = high.max(px);
      }
    }
    const int x0 = std::clamp(static_cast<int>(std::floor(low.x())) - 1, 0, config.width_px);
    const int y0 = std::clamp(static_cast<int>(std::floor(low.y())) - 1, 0, config.height_px);
    const int x1 = std::clamp(static_cast<int>(std::ceil(high.x())) + 2, x0, config.width_px);
    const int y1 = std::clamp(static_cast<int>(std::ceil(high.y())) + 2, y0, config.height_px);
    CameraIntrinsics part = lens;
    part.cx -= static_cast<float>(x0);
    part.cy -= static_cast<float>(y0);
    part.width_px = x1 - x0;
    part.height_px = y1 - y0;
    std::vector<render::HitImage> casts;
    for (const auto& offset : render::sample_offsets_px(config.rays_per_pixel)) {
      casts.push_back(caster.cast(part, offset));
    }
    const float share = 1.0F / static_cast<float>(casts.size());
    render::for_each_row(part.height_px, [&](int y) {
      for (int x = 0; x < part.width_px; ++x) {
        const auto at = static_cast<std::size_t>(y) * static_cast<std::size_t>(part.width_px) +
                        static_cast<std::size_t>(x);
        auto pixel = image.col(static_cast<Eigen::Index>(y + y0) * config.width_px + x + x0);
        Vector3f sum = Vector3f::Zero();
        for (const render::HitImage& hits : casts) {
          if (hits.triangle[at] < 0) {
            sum += pixel;
          } else {
            sum += render::interpolate(triangles, hits.triangle[at], hits.barycentric[at], colours);
          }
        }
        pixel = share * sum;
      }
    });
    return image;
  }

  /// Of a scene, in a camera's frame: from the first row's first light to the last row's last, evenly spaced;
  /// one alone where all rows see the frame's time.
  struct Moments {
    std::vector<mesh::Vertices> surfaces_mm;
    std::vector<Eigen::Matrix4Xf> strands;  ///< points as in render::Strands
  };

  /// middle, strands: the scene and its strands' points at the frame's time, in the first camera's frame
  Moments moments_of(std::size_t k, const Scene& middle, const Eigen::Matrix4Xf& strands,
                     double time_s) const {
    const double span_s = equipment[k].webcam.span_s();
    Moments moments;
    const auto add = [&](const Scene& scene, Eigen::Matrix4Xf points) {
      const Isometry3f& turn = views[k].view_from_first;
      moments.surfaces_mm.emplace_back(turn * scene.vertices_mm);
      points.topRows<3>() = turn * Eigen::Matrix3Xf(points.topRows<3>());
      moments.strands.push_back(std::move(points));
    };
    for (const double part : {-0.5, 0.0, 0.5}) {
      if (part == 0) {
        add(middle, strands);
      } else if (span_s > 0) {
        Scene scene;
        placed.build_scene(time_s + part * span_s, scene);
        add(scene, config.look.painted() ? strands : placed.strands_of(scene).points);
      }
    }
    return moments;
  }

  /// As expose_picture, through a webcam's lens and shutter: each ray at its own place and time. Colours stay
  /// those of the frame's time.
  Eigen::Matrix3Xf expose_webcam(std::size_t k, const std::vector<mesh::Vertices>& keys_mm,
                                 const mesh::Triangles& triangles, const Eigen::Matrix3Xf& colours,
                                 std::uint64_t noise_seed) const {
    const render::Raycaster caster(keys_mm, triangles, render::Raycaster::Build::Quick);
    const Optics optics = optics_of(k, noise_seed);
    const std::vector<Eigen::Vector2f> offsets_px = render::sample_offsets_px(ray_count(k));
    const Eigen::AlignedBox2i seen = box_px(rig.cameras[k].lens, keys_mm);
    Eigen::Matrix3Xf image = views[k].background;
    const auto share = 1 / static_cast<float>(offsets_px.size());
    render::for_each_row(config.height_px, [&](int y) {
      std::vector<PictureRay> rays(offsets_px.size());
      for (int x = 0; x < config.width_px; ++x) {
        if (!seen.contains(Eigen::Vector2i(x, y))) {
          continue;
        }
        optics.look(x, y, offsets_px, rays);
        auto pixel = image.col(static_cast<Eigen::Index>(y) * config.width_px + x);
        Vector3f sum = Vector3f::Zero();
        for (const PictureRay& ray : rays) {
          const auto hit = caster.first_hit(Vector3f::Zero(), ray.direction, 0, false, ray.time);
          sum += hit.triangle < 0 ? Vector3f(pixel)
                                  : render::interpolate(triangles, hit.triangle, hit.barycentric, colours);
        }
        pixel = share * sum;
      }
    });
    return image;
  }

  /// Pixels outside of which nothing of the scene is seen.
  static Eigen::AlignedBox2i box_px(const capture::Lens& lens, const std::vector<mesh::Vertices>& keys_mm) {
    Eigen::AlignedBox2d box;
    for (const mesh::Vertices& key_mm : keys_mm) {
      for (Eigen::Index v = 0; v < key_mm.cols(); ++v) {
        // Pinhole and distorted place: far outside the picture a distortion's polynomial means nothing.
        const Vector3f at = key_mm.col(v);
        constexpr float kNear_mm = 20;
        if (at.z() > kNear_mm) {
          const Eigen::Vector2d part = (at.head<2>() / at.z()).cast<double>();
          box.extend(Eigen::Vector2d(lens.fx_px * part.x() + lens.cx_px, lens.fy_px * part.y() + lens.cy_px));
          if (const auto px = lens.project(lens.camera_from_rig.inverse() * at.cast<double>())) {
            box.extend(*px);
          }
        }
      }
    }
    const Eigen::Vector2d low = box.min().cwiseMax(-1.0) - Eigen::Vector2d::Ones();
    const Eigen::Vector2d high =
        box.max().cwiseMin(Eigen::Vector2d(lens.width_px, lens.height_px)) + Eigen::Vector2d::Ones();
    return {low.cast<int>(), high.cast<int>()};
  }

  /// The linear picture of a painted actor through a webcam's lens or shutter. [3][pixels]
  /// scene, caster: at the frame's time, in the first camera's frame.
  Eigen::Matrix3Xf webcam_picture(std::size_t k, const Scene& scene, const render::Raycaster& caster,
                                  const Lighting& now, double time_s, std::uint64_t noise_seed) const {
    const Vector3f eye_mm = views[k].view_from_first.inverse().translation();
    const Eigen::Matrix3Xf colours = shade_vertices(scene, caster, now, config.highlights, eye_mm);
    return views[k].gain.asDiagonal() * expose_webcam(k, moments_of(k, scene, {}, time_s).surfaces_mm,
                                                      scene.triangles, colours, noise_seed);
  }
};

ActorSequence::ActorSequence(const face::FaceModel& model, const ActorSequenceConfig& config) {
  constexpr int kMaxSide_px = 8192;
  constexpr int kMaxCameras = 8;
  if (config.width_px < 16 || config.height_px < 16 || config.width_px > kMaxSide_px ||
      config.height_px > kMaxSide_px || config.frame_count < 1 || config.rate_hz < 1 || config.start_s < 0 ||
      config.outside_span_mm < 0 || config.rays_per_pixel < 1 || config.camera_count < 1 ||
      config.camera_count > kMaxCameras) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("a synthetic sequence of {} frames of {}x{} px at {} Hz cannot be made: sides are 16 to "
                    "{} px, counts and rates at least 1, cameras at most {}",
                    config.frame_count, config.width_px, config.height_px, config.rate_hz, kMaxSide_px,
                    kMaxCameras));
  }
  impl_ = std::make_unique<Impl>(model, config);
  impl_->place_camera();
  impl_->lighting = make_lighting(config.light, config.seed, impl_->placed.resting_pivot_mm());
  impl_->place_further_cameras();
  impl_->equip();
  impl_->expose();
}

ActorSequence::~ActorSequence() = default;

const ActorSequenceConfig& ActorSequence::config() const {
  return impl_->config;
}
const CameraIntrinsics& ActorSequence::camera() const {
  return impl_->camera;
}
const capture::Rig& ActorSequence::rig() const {
  return impl_->rig;
}
const std::string& ActorSequence::model_name() const {
  return impl_->model_name;
}
const Webcam& ActorSequence::webcam() const {
  return impl_->equipment.front().webcam;
}
const std::vector<std::string>& ActorSequence::expression_names() const {
  return impl_->placed.actor().expression_names();
}
const std::vector<float>& ActorSequence::identity() const {
  return impl_->placed.actor().identity();
}
float ActorSequence::outside_span_rms_mm() const {
  return impl_->placed.actor().outside_span_rms_mm();
}
TruthMesh ActorSequence::neutral() const {
  return impl_->placed.neutral();
}
const Lighting& ActorSequence::lighting() const {
  return impl_->lighting;
}

SyntheticFrame ActorSequence::render(int index, TruthMesh* truth, TruthMesh* surfaces) const {
  const double time_s = impl_->time_s(index);
  SyntheticFrame frame;
  frame.expression = impl_->placed.expression(time_s);
  frame.camera_from_head = impl_->placed.place_from_head(time_s);
  Scene scene;
  impl_->placed.build_scene(time_s, scene);
  if (truth != nullptr) {
    *truth = impl_->placed.head_of(scene);
  }
  if (surfaces != nullptr) {
    *surfaces = {scene.vertices_mm, scene.normals, scene.albedo, scene.triangles};
  }
  const ActorSequenceConfig& config = impl_->config;
  const Lighting lighting = impl_->light_of(index, frame.lamp);
  const bool painted = config.look.painted();
  const render::Raycaster caster(scene.vertices_mm, scene.triangles);
  const render::StrandCaster strands(painted ? render::Strands{} : impl_->placed.strands_of(scene));
  for (std::size_t k = 0; k < impl_->views.size(); ++k) {
    const std::uint64_t noise_seed =
        mix(config.seed * 0x10001ULL + static_cast<std::uint64_t>(index) + (k << 40U));
    Eigen::Matrix3Xf light =
        !painted ? impl_->look_picture(k, scene, strands, caster, lighting, time_s, noise_seed)
        : impl_->equipment[k].rays ? impl_->webcam_picture(k, scene, caster, lighting, time_s, noise_seed)
                                   : impl_->painted_picture(impl_->views[k], scene, caster, lighting);
    Sensor sensor;  // a small one
    sensor.noise = config.sensor_noise;
    if (const auto& controls = impl_->equipment[k].controls) {
      const CameraSettings& settings = controls->at(index);
      light = (settings.gain * settings.white_balance).asDiagonal() * light;
      sensor.full_well_e /= settings.gain;  // white is fewer electrons
      if (k == 0) {
        frame.settings = settings;
      }
    }
    render::Picture picture;
    picture.width_px = config.width_px;
    picture.height_px = config.height_px;
    picture.rgb = develop(light, config.width_px, config.height_px, sensor, noise_seed);
    if (k == 0) {
      frame.picture = std::move(picture);
    } else {
      frame.further_pictures.push_back(std::move(picture));
    }
  }
  return frame;
}

}  // namespace facet::simulation
