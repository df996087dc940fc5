#include "simulation/studio.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "facet/error.hpp"
#include "simulation/actor.hpp"
#include "simulation/performance.hpp"
#include "simulation/random.hpp"
#include "simulation/shading.hpp"

namespace facet::simulation {
namespace {

using Eigen::Isometry3f;
using Eigen::Vector3f;

constexpr float kDegree = std::numbers::pi_v<float> / 180;
constexpr float kFullWell_e = 6000;  // electrons of a white pixel: a small webcam sensor
constexpr float kReadNoise_e = 5;
constexpr float kSkinExposure = 0.72F;  // linear value of the brightest skin
constexpr float kSide = 0.1F;           // the optics' blur: part of each neighbour, along rows and columns

/// Head axes (x left, y up, z out) in camera axes (x right, y down, z forward) for a head that faces the
/// camera.
Eigen::Matrix3f camera_from_head_axes() {
  return Vector3f(1, -1, -1).asDiagonal();
}

Eigen::Matrix3f turn(const HeadMotion& motion) {
  return (Eigen::AngleAxisf(motion.yaw_rad, Vector3f::UnitY()) *
          Eigen::AngleAxisf(motion.pitch_rad, Vector3f::UnitX()) *
          Eigen::AngleAxisf(motion.roll_rad, Vector3f::UnitZ()))
      .toRotationMatrix();
}

/// A room out of focus: soft shapes over a gradient, linear RGB, [3][pixel_count].
Eigen::Matrix3Xf make_background(const StudioConfig& config) {
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

/// sRGB values of evenly spaced linear ones: the transfer function is too slow for every pixel.
std::uint8_t encode(float linear) {
  constexpr int kSteps = 1 << 15;
  static const std::vector<std::uint8_t> table = [] {
    std::vector<std::uint8_t> made(kSteps + 1);
    for (int k = 0; k <= kSteps; ++k) {
      made[static_cast<std::size_t>(k)] = render::linear_to_srgb8(static_cast<float>(k) / kSteps);
    }
    return made;
  }();
  return table[static_cast<std::size_t>(std::lround(std::clamp(linear, 0.0F, 1.0F) * kSteps))];
}

/// About a standard normal: the sum of four uniform values.
float rough_normal(std::uint64_t hash) {
  float sum = 0;
  for (int part = 0; part < 4; ++part) {
    sum += static_cast<float>((hash >> (16 * part)) & 0xFFFF) / 65535.0F;
  }
  return (sum - 2) * std::numbers::sqrt3_v<float>;
}

}  // namespace

struct Studio::Impl {
  StudioConfig config;
  VirtualActor actor;
  Performance performance;
  CameraIntrinsics camera;
  Vector3f pivot_mm{0, 0, 0};          ///< head frame: what the head turns about
  Vector3f resting_pivot_mm{0, 0, 0};  ///< camera frame
  Lighting lighting;
  Eigen::Matrix3Xf background;

  Impl(const face::FaceModel& model, const StudioConfig& given)
      : config(given),
        actor(model, given.seed, given.glasses),
        performance(given.seed, static_cast<double>(given.frame_count) / given.rate_hz + 1) {}

  double time_s(int index) const { return static_cast<double>(index) / config.rate_hz; }

  void place_camera() {
    Random random(config.seed, 83);
    const float field_rad = random.uniform(45, 60) * kDegree;
    const auto width = static_cast<float>(config.width_px);
    const auto height = static_cast<float>(config.height_px);
    const float focal_px = 0.5F * std::max(width, height) / std::tan(0.5F * field_rad);
    camera = {focal_px, focal_px, 0.5F * (width - 1), 0.5F * (height - 1), config.width_px, config.height_px};
    const Anatomy& face = actor.anatomy();
    const float face_mm = (face.forehead - face.chin).norm();
    const float part = random.uniform(0.38F, 0.48F);  // of the picture's height that the face fills
    constexpr float kNearest_mm = 450;
    constexpr float kFarthest_mm = 700;
    const float distance_mm =
        std::clamp(focal_px * face_mm / (part * std::min(height, width)), kNearest_mm, kFarthest_mm);
    const Vector3f middle = 0.5F * (face.forehead + face.chin);
    const Vector3f middle_camera(random.uniform(-25, 25), random.uniform(-10, 20), distance_mm);
    pivot_mm = Vector3f(0, face.chin.y() + 25, face.nasion.z() - 95);
    resting_pivot_mm = middle_camera + camera_from_head_axes() * (pivot_mm - middle);
  }

  Isometry3f camera_from_head(int index) const {
    const HeadMotion motion = performance.head(time_s(index));
    Isometry3f pose = Isometry3f::Identity();
    pose.linear() = camera_from_head_axes() * turn(motion);
    pose.translation() = resting_pivot_mm + motion.shift_mm - pose.linear() * pivot_mm;
    return pose;
  }

  /// Where the body is: it follows the head's shift by half and turns little.
  Isometry3f camera_from_body(int index) const {
    HeadMotion motion = performance.head(time_s(index));
    motion.yaw_rad *= 0.2F;
    motion.pitch_rad = 0;
    motion.roll_rad = 0;
    Isometry3f pose = Isometry3f::Identity();
    pose.linear() = camera_from_head_axes() * turn(motion);
    pose.translation() = resting_pivot_mm + 0.6F * motion.shift_mm - pose.linear() * pivot_mm;
    return pose;
  }

  void build_scene(int index, const std::vector<float>& expression, Scene& scene, TruthMesh* truth) const {
    ActorShape shape;
    actor.shape(expression, performance.gaze(time_s(index)), shape);
    const Isometry3f head = camera_from_head(index);
    const mesh::Vertices head_mm = head * shape.head_mm;
    const Eigen::Matrix3Xf head_normals = head.linear() * shape.head_normals;
    scene.clear();
    scene.add(head_mm, head_normals, actor.head_albedo(), actor.head_materials(), actor.head_triangles(),
              actor.openness());
    if (truth != nullptr) {
      *truth = {head_mm, head_normals, actor.head_albedo(), actor.head_triangles()};
    }
    const auto add = [&](const mesh::Vertices& part_mm, const Surface& surface) {
      Eigen::Matrix3Xf normals;
      mesh::vertex_normals(part_mm, surface.triangles, normals);
      scene.add(part_mm, normals, surface.albedo, surface.materials, surface.triangles, {});
    };
    for (const Eyeball& eyeball : actor.eyeballs()) {
      const Surface& surface = actor.eyeball_surface();
      const mesh::Vertices turned_mm =
          (gaze_rotation(shape.gaze) * surface.vertices_mm).colwise() + eyeball.centre_mm;
      add(head * turned_mm, surface);
    }
    add(head * actor.upper_teeth().vertices_mm, actor.upper_teeth());
    add(head * shape.lower_teeth_mm, actor.lower_teeth());
    const Isometry3f body = camera_from_body(index);
    const Torso& torso = actor.torso();
    mesh::Vertices torso_mm(3, torso.surface.vertices_mm.cols());
    for (Eigen::Index v = 0; v < torso_mm.cols(); ++v) {
      const Vector3f at = torso.surface.vertices_mm.col(v);
      const float hold = torso.hold[static_cast<std::size_t>(v)];
      torso_mm.col(v) = hold * (head * at) + (1 - hold) * (body * at);
    }
    add(torso_mm, torso.surface);
    if (actor.glasses().vertices_mm.cols() > 0) {
      add(head * actor.glasses().vertices_mm, actor.glasses());
    }
  }

  /// Sets the light so that the face's brightest skin comes out as kSkinExposure in the first frame.
  void expose() {
    Scene scene;
    build_scene(0, performance.expression(0, actor.expression_names()), scene, nullptr);
    const render::Raycaster caster(scene.vertices_mm, scene.triangles);
    const Eigen::Matrix3Xf colours = shade_vertices(scene, caster, lighting, false);
    std::vector<float> values;
    for (Eigen::Index v = 0; v < actor.face_skin().size(); ++v) {
      if (actor.face_skin()[v] > 0.9F && colours.col(v).maxCoeff() > 0) {
        values.push_back(colours.col(v).maxCoeff());
      }
    }
    if (values.empty()) {
      throw Error(ErrorKind::UnreadableInput,
                  "the face model marks no refinable skin that the camera could see");
    }
    const auto brightest =
        values.begin() + static_cast<std::ptrdiff_t>(0.97 * static_cast<double>(values.size()));
    std::nth_element(values.begin(), brightest, values.end());
    const float exposure = kSkinExposure / *brightest;
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

  /// The linear picture: the scene over the background, averaged over the rays of each pixel. [3][pixels]
  Eigen::Matrix3Xf expose_picture(const Scene& scene, const render::Raycaster& caster,
                                  const Eigen::Matrix3Xf& colours) const {
    Eigen::Matrix3Xf image = background;
    // Rays only where the scene can be.
    Eigen::Array2f low(static_cast<float>(config.width_px), static_cast<float>(config.height_px));
    Eigen::Array2f high(0, 0);
    for (Eigen::Index v = 0; v < scene.vertices_mm.cols(); ++v) {
      const Vector3f at = scene.vertices_mm.col(v);
      constexpr float kNear_mm = 20;
      if (at.z() > kNear_mm) {
        const Eigen::Array2f px(camera.fx * at.x() / at.z() + camera.cx,
                                camera.fy * at.y() / at.z() + camera.cy);
        low = low.min(px);
        high = high.max(px);
      }
    }
    const int x0 = std::clamp(static_cast<int>(std::floor(low.x())) - 1, 0, config.width_px);
    const int y0 = std::clamp(static_cast<int>(std::floor(low.y())) - 1, 0, config.height_px);
    const int x1 = std::clamp(static_cast<int>(std::ceil(high.x())) + 2, x0, config.width_px);
    const int y1 = std::clamp(static_cast<int>(std::ceil(high.y())) + 2, y0, config.height_px);
    CameraIntrinsics part = camera;
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
            sum += render::interpolate(scene.triangles, hits.triangle[at], hits.barycentric[at], colours);
          }
        }
        pixel = share * sum;
      }
    });
    return image;
  }

  /// Optics, sensor and encoding: a slight blur, shot and read noise, sRGB.
  render::Picture develop(const Eigen::Matrix3Xf& image, int index) const {
    const int width = config.width_px;
    const int height = config.height_px;
    render::Picture picture = render::plain_picture(width, height, {0, 0, 0});
    const auto at = [&](int x, int y) {
      return image.col(static_cast<Eigen::Index>(std::clamp(y, 0, height - 1)) * width +
                       std::clamp(x, 0, width - 1));
    };
    const std::uint64_t frame_seed = mix(config.seed * 0x10001ULL + static_cast<std::uint64_t>(index));
    render::for_each_row(height, [&](int y) {
      for (int x = 0; x < width; ++x) {
        const Vector3f edges = at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1);
        const Vector3f corners = at(x - 1, y - 1) + at(x + 1, y - 1) + at(x - 1, y + 1) + at(x + 1, y + 1);
        constexpr float kCentre = 1 - 2 * kSide;
        const Vector3f value =
            kCentre * kCentre * at(x, y) + kCentre * kSide * edges + kSide * kSide * corners;
        const std::size_t pixel =
            static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
        for (std::size_t channel = 0; channel < 3; ++channel) {
          const float light = std::max(0.0F, value[static_cast<Eigen::Index>(channel)]);
          float noise = 0;
          if (config.sensor_noise) {
            const float sigma = std::sqrt(light * kFullWell_e + kReadNoise_e * kReadNoise_e) / kFullWell_e;
            noise = sigma * rough_normal(mix(frame_seed + 3 * pixel + channel));
          }
          picture.rgb[3 * pixel + channel] = encode(light + noise);
        }
      }
    });
    return picture;
  }
};

Studio::Studio(const face::FaceModel& model, const StudioConfig& config) {
  constexpr int kMaxSide_px = 8192;
  if (config.width_px < 16 || config.height_px < 16 || config.width_px > kMaxSide_px ||
      config.height_px > kMaxSide_px || config.frame_count < 1 || config.rate_hz < 1 ||
      config.rays_per_pixel < 1) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("a synthetic sequence of {} frames of {}x{} px at {} Hz cannot be made: sides are 16 to "
                    "{} px, counts and rates at least 1",
                    config.frame_count, config.width_px, config.height_px, config.rate_hz, kMaxSide_px));
  }
  impl_ = std::make_unique<Impl>(model, config);
  impl_->place_camera();
  impl_->lighting = make_lighting(config.light, config.seed, impl_->resting_pivot_mm);
  impl_->background = make_background(config);
  impl_->expose();
}

Studio::~Studio() = default;

const StudioConfig& Studio::config() const {
  return impl_->config;
}
const CameraIntrinsics& Studio::camera() const {
  return impl_->camera;
}
const std::vector<std::string>& Studio::expression_names() const {
  return impl_->actor.expression_names();
}
const std::vector<float>& Studio::identity() const {
  return impl_->actor.identity();
}
float Studio::outside_span_rms_mm() const {
  return impl_->actor.outside_span_rms_mm();
}
const Lighting& Studio::lighting() const {
  return impl_->lighting;
}

SyntheticFrame Studio::render(int index, TruthMesh* truth) const {
  SyntheticFrame frame;
  frame.expression = impl_->performance.expression(impl_->time_s(index), impl_->actor.expression_names());
  frame.camera_from_head = impl_->camera_from_head(index);
  Scene scene;
  impl_->build_scene(index, frame.expression, scene, truth);
  const render::Raycaster caster(scene.vertices_mm, scene.triangles);
  const Eigen::Matrix3Xf colours = shade_vertices(scene, caster, impl_->lighting, impl_->config.highlights);
  frame.picture = impl_->develop(impl_->expose_picture(scene, caster, colours), index);
  return frame;
}

}  // namespace facet::simulation
