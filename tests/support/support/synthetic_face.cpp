#include "support/synthetic_face.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace facet::refine::synthetic {
namespace {

// Half axes of the ellipsoid and half extents of the cap that is cut from it, mm.
constexpr float kAxisX = 88;
constexpr float kAxisY = 118;
constexpr float kAxisZ = 75;
constexpr float kHalfWidth = 58;
constexpr float kHalfHeight = 76;
constexpr float kPi = 3.14159265F;

float bell(float x, float y, float x0, float y0, float sigma_x, float sigma_y) {
  const float u = (x - x0) / sigma_x;
  const float v = (y - y0) / sigma_y;
  return std::exp(-0.5F * (u * u + v * v));
}

}  // namespace

float displacement_mm(const Scene& scene, float x, float y) {
  const float features = 1.6F * bell(x, y, 0, -6, 9, 14) - 0.9F * bell(x, y, -22, 14, 9, 7) -
                         0.9F * bell(x, y, 22, 14, 9, 7) + 0.7F * bell(x, y, 0, -38, 15, 7) +
                         0.8F * bell(x, y, -32, -14, 13, 13) + 0.8F * bell(x, y, 32, -14, 13, 13);
  const float forehead = 0.22F * std::sin(2 * kPi * (y + scene.bump_phase) / 7) * bell(x, y, 0, 46, 26, 14);
  const float crow = 0.14F * std::sin(2 * kPi * (0.8F * x + 0.6F * y) / 4.5F) *
                     (bell(x, y, 40, 18, 9, 9) + bell(x, y, -40, 18, 9, 9));
  const float fold =
      -0.5F * (bell(x - 0.3F * y, y, 20, -24, 1.8F, 16) + bell(x + 0.3F * y, y, -20, -24, 1.8F, 16));
  return scene.bump_scale * (features + forehead + crow + fold);
}

Eigen::Vector3f albedo(const Scene& scene, float x, float y) {
  const float tone = 1 + 0.06F * std::sin(x / 31) * std::cos(y / 43);
  Eigen::Vector3f rho = tone * Eigen::Vector3f(0.55F, 0.37F, 0.29F);
  const float flush = bell(x, y, -32, -14, 13, 13) + bell(x, y, 32, -14, 13, 13);
  rho.y() *= 1 - 0.15F * flush;
  rho.z() *= 1 - 0.18F * flush;
  if (scene.marks) {
    const float brows = bell(x, y, -24, 27, 10, 2.2F) + bell(x, y, 24, 27, 10, 2.2F);
    const float moles = bell(x, y, -28, -34, 1.5F, 1.5F) + bell(x, y, 36, -4, 1.2F, 1.2F);
    rho = rho.cwiseProduct(Eigen::Vector3f::Ones() -
                           std::min(1.0F, 0.75F * brows + 0.6F * moles) * Eigen::Vector3f(0.8F, 0.9F, 0.95F));
  }
  return rho;
}

Eigen::Vector3f cap_point(float x, float y) {
  const float u = x / kAxisX;
  const float v = y / kAxisY;
  return {x, y, kAxisZ * std::sqrt(std::max(0.02F, 1 - u * u - v * v))};
}

Eigen::Vector3f cap_normal(float x, float y) {
  const Eigen::Vector3f p = cap_point(x, y);
  return Eigen::Vector3f(p.x() / (kAxisX * kAxisX), p.y() / (kAxisY * kAxisY), p.z() / (kAxisZ * kAxisZ))
      .normalized();
}

Eigen::Vector3f true_point(const Scene& scene, float x, float y) {
  return cap_point(x, y) + displacement_mm(scene, x, y) * cap_normal(x, y);
}

Eigen::Vector3f true_normal(const Scene& scene, float x, float y) {
  constexpr float kStepMm = 0.05F;
  const Eigen::Vector3f across = true_point(scene, x + kStepMm, y) - true_point(scene, x - kStepMm, y);
  const Eigen::Vector3f up = true_point(scene, x, y + kStepMm) - true_point(scene, x, y - kStepMm);
  return across.cross(up).normalized();
}

Cap make_cap(const Scene& scene) {
  const int columns = static_cast<int>(2 * kHalfWidth / scene.quad_mm) + 1;
  const int rows = static_cast<int>(2 * kHalfHeight / scene.quad_mm) + 1;
  Cap out;
  const Eigen::Index count = columns * rows;
  out.control.vertex_count = static_cast<std::int32_t>(count);
  out.control.texture_coordinates.resize(2, count);
  out.control.refinable.assign(static_cast<std::size_t>(count), 1);
  out.vertices_mm.resize(3, count);
  out.mean_albedo = Eigen::Vector3f(0.55F, 0.37F, 0.29F).replicate(1, count);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const float u = static_cast<float>(column) / static_cast<float>(columns - 1);
      const float v = static_cast<float>(row) / static_cast<float>(rows - 1);
      const Eigen::Index i = row * columns + column;
      out.control.texture_coordinates.col(i) << u, v;
      out.vertices_mm.col(i) = cap_point((2 * u - 1) * kHalfWidth, (2 * v - 1) * kHalfHeight);
    }
  }
  out.control.quads.resize(4, (columns - 1) * (rows - 1));
  Eigen::Index quad = 0;
  for (int row = 0; row + 1 < rows; ++row) {
    for (int column = 0; column + 1 < columns; ++column) {
      const int i = row * columns + column;
      out.control.quads.col(quad++) << i, i + 1, i + columns + 1, i + columns;
    }
  }
  return out;
}

CameraIntrinsics camera(const Scene& scene) {
  CameraIntrinsics out;
  out.width_px = scene.image_width_px;
  out.height_px = scene.image_height_px;
  // The cap's height fills most of the picture.
  out.fx = out.fy =
      0.85F * static_cast<float>(scene.image_height_px) * (scene.distance_mm - kAxisZ) / (2 * kHalfHeight);
  out.cx = 0.5F * static_cast<float>(scene.image_width_px - 1);
  out.cy = 0.5F * static_cast<float>(scene.image_height_px - 1);
  return out;
}

Eigen::Isometry3f camera_from_head(const Scene& scene) {
  Eigen::Isometry3f out = Eigen::Isometry3f::Identity();
  out.translate(Eigen::Vector3f(0, 0, scene.distance_mm));
  out.rotate(Eigen::AngleAxisf(kPi, Eigen::Vector3f::UnitX()));
  out.rotate(Eigen::AngleAxisf(scene.yaw_rad, Eigen::Vector3f::UnitY()));
  return out;
}

Eigen::Isometry3f view_from_reference(const Scene& scene) {
  const Eigen::Vector3f middle(0, 0, scene.distance_mm - kAxisZ);
  Eigen::Isometry3f out = Eigen::Isometry3f::Identity();
  out.linear() = Eigen::AngleAxisf(scene.camera_yaw_rad, Eigen::Vector3f::UnitY()).toRotationMatrix();
  out.translation() = middle - out.linear() * middle;
  return out;
}

Eigen::Vector2f project(const CameraIntrinsics& camera, const Eigen::Vector3f& point) {
  return {camera.fx * point.x() / point.z() + camera.cx, camera.fy * point.y() / point.z() + camera.cy};
}

std::shared_ptr<const mesh::Hierarchy> hierarchy(const Scene& scene, const Cap& cap,
                                                 const mesh::HierarchyOptions& options) {
  mesh::TextureCoordinates control_px(2, cap.vertices_mm.cols());
  const Eigen::Isometry3f pose = camera_from_head(scene);
  for (Eigen::Index i = 0; i < control_px.cols(); ++i) {
    control_px.col(i) = project(camera(scene), pose * cap.vertices_mm.col(i).eval());
  }
  return mesh::build_hierarchy(cap.control, control_px,
                               std::vector<std::uint8_t>(static_cast<std::size_t>(control_px.cols()), 1),
                               options);
}

float shade(const std::array<float, 9>& l, const Eigen::Vector3f& n) {
  return l[0] + l[1] * n.x() + l[2] * n.y() + l[3] * n.z() + l[4] * n.x() * n.y() + l[5] * n.x() * n.z() +
         l[6] * n.y() * n.z() + l[7] * (n.x() * n.x() - n.y() * n.y()) + l[8] * (3 * n.z() * n.z() - 1);
}

Frame render(const Scene& scene) {
  constexpr float kGridMm = 0.5F;
  const CameraIntrinsics view = camera(scene);
  const Eigen::Isometry3f pose = camera_from_head(scene);
  const Eigen::Isometry3f from_there = view_from_reference(scene);
  const int columns = static_cast<int>(2 * kHalfWidth / kGridMm) + 1;
  const int rows = static_cast<int>(2 * kHalfHeight / kGridMm) + 1;
  struct Corner {
    Eigen::Vector2f px;
    float depth_mm;
    Eigen::Vector3f colour;
  };
  std::vector<Corner> corners;
  corners.reserve(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows));
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const float x = -kHalfWidth + kGridMm * static_cast<float>(column);
      const float y = -kHalfHeight + kGridMm * static_cast<float>(row);
      const Eigen::Vector3f in_camera = from_there * (pose * true_point(scene, x, y));
      const Eigen::Vector3f normal_camera = pose.linear() * true_normal(scene, x, y);
      const Eigen::Vector3f normal(normal_camera.x(), -normal_camera.y(), -normal_camera.z());
      Eigen::Vector3f colour = shade(scene.lighting, normal) * albedo(scene, x, y);
      if (scene.highlight) {
        const float along = std::max(0.0F, normal.dot(Eigen::Vector3f(0.25F, 0.45F, 0.86F).normalized()));
        colour.array() += 0.9F * std::pow(along, 90.0F);
      }
      corners.push_back({project(view, in_camera), in_camera.z(), colour});
    }
  }
  const auto width = static_cast<std::size_t>(scene.image_width_px);
  const auto height = static_cast<std::size_t>(scene.image_height_px);
  std::vector<float> nearest(width * height, std::numeric_limits<float>::infinity());
  std::vector<Eigen::Vector3f> linear(width * height, Eigen::Vector3f::Zero());
  const auto draw = [&](const Corner& a, const Corner& b, const Corner& c) {
    const auto cross = [](const Eigen::Vector2f& u, const Eigen::Vector2f& v) {
      return u.x() * v.y() - u.y() * v.x();
    };
    const float area = cross(b.px - a.px, c.px - a.px);
    if (std::abs(area) < 1e-12F) {
      return;
    }
    const Eigen::Vector2f low = a.px.cwiseMin(b.px).cwiseMin(c.px);
    const Eigen::Vector2f high = a.px.cwiseMax(b.px).cwiseMax(c.px);
    for (int y = std::max(0, static_cast<int>(std::ceil(low.y())));
         y <= std::min(static_cast<int>(height) - 1, static_cast<int>(high.y())); ++y) {
      for (int x = std::max(0, static_cast<int>(std::ceil(low.x())));
           x <= std::min(static_cast<int>(width) - 1, static_cast<int>(high.x())); ++x) {
        const Eigen::Vector2f p(static_cast<float>(x), static_cast<float>(y));
        const float wb = cross(p - a.px, c.px - a.px) / area;
        const float wc = cross(b.px - a.px, p - a.px) / area;
        const float wa = 1 - wb - wc;
        constexpr float kEdge = -1e-5F;
        if (wa < kEdge || wb < kEdge || wc < kEdge) {
          continue;
        }
        const float depth = wa * a.depth_mm + wb * b.depth_mm + wc * c.depth_mm;
        const std::size_t at = static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
        if (depth < nearest[at]) {
          nearest[at] = depth;
          linear[at] = wa * a.colour + wb * b.colour + wc * c.colour;
        }
      }
    }
  };
  for (int row = 0; row + 1 < rows; ++row) {
    for (int column = 0; column + 1 < columns; ++column) {
      const auto i = static_cast<std::size_t>(row * columns + column);
      const auto up = i + static_cast<std::size_t>(columns);
      draw(corners[i], corners[i + 1], corners[up + 1]);
      draw(corners[i], corners[up + 1], corners[up]);
    }
  }
  std::mt19937 random(scene.seed);
  std::normal_distribution<float> noise(0, 1);
  auto pixels = std::make_shared<std::uint8_t[]>(width * height * 4);
  for (std::size_t i = 0; i < width * height; ++i) {
    for (int channel = 0; channel < 3; ++channel) {
      const float value =
          std::clamp(scene.exposure.at(static_cast<std::size_t>(channel)) * linear[i][channel], 0.0F, 1.0F);
      const float srgb = value <= 0.0031308F ? 12.92F * value : 1.055F * std::pow(value, 1 / 2.4F) - 0.055F;
      const float counts = 255 * srgb + (scene.noise > 0 ? scene.noise * noise(random) : 0.0F);
      pixels.get()[i * 4 + static_cast<std::size_t>(channel)] =
          static_cast<std::uint8_t>(std::lround(std::clamp(counts, 0.0F, 255.0F)));
    }
    pixels.get()[i * 4 + 3] = 255;
  }
  Frame out;
  out.width_px = scene.image_width_px;
  out.height_px = scene.image_height_px;
  out.stride_bytes = width * 4;
  out.pixels = pixels;
  return out;
}

Errors compare(const Scene& scene, const Eigen::Matrix3Xf& vertices_mm, const Eigen::Matrix3Xf& normals,
               const Eigen::Matrix2Xf& cap_xy_mm, float margin_mm) {
  Errors out;
  double count = 0;
  for (Eigen::Index i = 0; i < normals.cols(); ++i) {
    const float x = cap_xy_mm(0, i);
    const float y = cap_xy_mm(1, i);
    if (std::abs(x) > kHalfWidth - margin_mm || std::abs(y) > kHalfHeight - margin_mm) {
      continue;
    }
    const Eigen::Vector3f truth = true_normal(scene, x, y);
    const float cosine = std::clamp(truth.dot(normals.col(i)), -1.0F, 1.0F);
    out.normal_deg += static_cast<double>(std::acos(cosine)) * 180 / static_cast<double>(kPi);
    out.distance_mm +=
        static_cast<double>(std::abs((vertices_mm.col(i) - true_point(scene, x, y)).dot(truth)));
    count += 1;
  }
  out.normal_deg /= count;
  out.distance_mm /= count;
  return out;
}

}  // namespace facet::refine::synthetic
