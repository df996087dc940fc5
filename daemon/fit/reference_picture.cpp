#include "fit/reference_picture.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include "maths/srgb.hpp"

namespace facet::fit {

using Eigen::Vector2f;
using Eigen::Vector3f;

struct ReferencePicture::Impl {
  capture::Lens lens;
  Frame picture;
  mesh::Triangles triangles;
  std::vector<Vector3f> pixels;  ///< [vertex_count] where the reference shows a vertex; NaN where it does not
  std::vector<float> light;      ///< [height][width] all that the skin got; 0: not known. Empty: nowhere
  float room = 0;                ///< of the same, what did not come from the projectors

  void look_at_light(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                     const ProjectedLight& projectors);
  /// Between four pixels; 0 where one of them is not known.
  float light_at(const Vector2f& at) const;
};

namespace {

constexpr float kMostGain = 4;  ///< of what is relit
constexpr std::uint8_t kSaturated = 250;
constexpr double kLeastRoom = 0.02;  ///< of the projectors' light on the mean
constexpr float kNowhere = std::numeric_limits<float>::quiet_NaN();

/// [vertex_count] pixel and distance along z; NaN where a vertex is not visible.
std::vector<Vector3f> project_all(const capture::Lens& lens, const mesh::Vertices& vertices_mm,
                                  const std::vector<std::uint8_t>& visible) {
  const Eigen::RowVector3f along_z = lens.camera_from_rig.linear().row(2).cast<float>();
  const auto from_z = static_cast<float>(lens.camera_from_rig.translation().z());
  std::vector<Vector3f> pixels(static_cast<std::size_t>(vertices_mm.cols()), Vector3f::Constant(kNowhere));
  for (std::size_t v = 0; v < pixels.size(); ++v) {
    if (visible[v] != 0) {
      if (const auto pixel = lens.project(vertices_mm.col(static_cast<Eigen::Index>(v)).cast<double>())) {
        pixels[v] << pixel->cast<float>(), along_z * vertices_mm.col(static_cast<Eigen::Index>(v)) + from_z;
      }
    }
  }
  return pixels;
}

/// A bilinear sample; false at the rim.
bool sample(const Frame& picture, const Vector2f& at, std::array<float, 3>& rgb) {
  if (!(at.x() >= 0) || !(at.y() >= 0) || !(at.x() < static_cast<float>(picture.width_px - 1)) ||
      !(at.y() < static_cast<float>(picture.height_px - 1))) {
    return false;
  }
  const int left = static_cast<int>(at.x());
  const int top = static_cast<int>(at.y());
  const float u = at.x() - static_cast<float>(left);
  const float v = at.y() - static_cast<float>(top);
  const std::uint8_t* upper = picture.row(top) + 4 * static_cast<std::ptrdiff_t>(left);
  const std::uint8_t* lower = picture.row(top + 1) + 4 * static_cast<std::ptrdiff_t>(left);
  for (std::size_t c = 0; c < 3; ++c) {
    const float above = static_cast<float>(upper[c]) * (1 - u) + static_cast<float>(upper[c + 4]) * u;
    const float below = static_cast<float>(lower[c]) * (1 - u) + static_cast<float>(lower[c + 4]) * u;
    rgb[c] = above * (1 - v) + below * v;
  }
  return true;
}

/// Calls for every pixel inside a triangle of which all corners are known: work(x, y, corners' vertices,
/// their weights).
template <typename Work>
void for_each_pixel(const mesh::Triangles& triangles, const std::vector<Vector3f>& pixels, int width_px,
                    int height_px, const Work& work) {
  const auto width = static_cast<std::size_t>(width_px);
  std::vector<float> nearest(width * static_cast<std::size_t>(height_px),
                             std::numeric_limits<float>::infinity());
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    std::array<Vector2f, 3> at;
    Vector3f depth;
    bool known = true;
    for (std::size_t i = 0; i < 3; ++i) {
      const Vector3f& corner = pixels[static_cast<std::size_t>(triangles(static_cast<Eigen::Index>(i), t))];
      at[i] = corner.head<2>();
      depth[static_cast<Eigen::Index>(i)] = corner.z();
      known = known && corner.allFinite();
    }
    if (!known) {
      continue;
    }
    const Vector2f a = at[1] - at[0];
    const Vector2f b = at[2] - at[0];
    const float area = a.x() * b.y() - a.y() * b.x();
    if (!(std::abs(area) > 1e-6F)) {
      continue;
    }
    const auto [least_x, most_x] = std::minmax({at[0].x(), at[1].x(), at[2].x()});
    const auto [least_y, most_y] = std::minmax({at[0].y(), at[1].y(), at[2].y()});
    const int x1 = std::min(width_px - 1, static_cast<int>(std::floor(most_x)));
    const int y1 = std::min(height_px - 1, static_cast<int>(std::floor(most_y)));
    for (int y = std::max(0, static_cast<int>(std::ceil(least_y))); y <= y1; ++y) {
      for (int x = std::max(0, static_cast<int>(std::ceil(least_x))); x <= x1; ++x) {
        const Vector2f way = Vector2f(static_cast<float>(x), static_cast<float>(y)) - at[0];
        const float w1 = (way.x() * b.y() - way.y() * b.x()) / area;
        const float w2 = (a.x() * way.y() - a.y() * way.x()) / area;
        const Vector3f weights(1 - w1 - w2, w1, w2);
        float& before = nearest[static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x)];
        if (weights.minCoeff() >= 0 && weights.dot(depth) < before) {
          before = weights.dot(depth);
          work(x, y, triangles.col(t), weights);
        }
      }
    }
  }
}

/// What a mesh's field is at a point of a triangle.
template <typename Corners>
Vector3f between(const Eigen::Matrix3Xf& field, const Corners& corners, const Vector3f& weights) {
  return weights[0] * field.col(corners[0]) + weights[1] * field.col(corners[1]) +
         weights[2] * field.col(corners[2]);
}

std::uint8_t relit(float value, float gain) {
  if (gain == 1) {
    return static_cast<std::uint8_t>(std::lround(value));
  }
  const float linear = maths::decode_srgb(value / 255);
  return static_cast<std::uint8_t>(std::lround(255 * maths::encode_srgb(std::min(1.0F, gain * linear))));
}

}  // namespace

/// Brightness as a line over the projectors' light, by least squares: where it begins is the room's share.
void ReferencePicture::Impl::look_at_light(const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                                           const ProjectedLight& projectors) {
  const auto width = static_cast<std::size_t>(picture.width_px);
  const std::array<float, 256>& decoded = maths::decoded_srgb8();
  light.assign(width * static_cast<std::size_t>(picture.height_px), -1.0F);
  double n = 0, x = 0, y = 0, xx = 0, xy = 0;
  for_each_pixel(triangles, pixels, picture.width_px, picture.height_px,
                 [&](int column, int row, const auto& corners, const Vector3f& weights) {
                   const float given = projectors.at(between(vertices_mm, corners, weights),
                                                     between(normals, corners, weights).normalized());
                   const std::uint8_t* rgb = picture.row(row) + 4 * static_cast<std::ptrdiff_t>(column);
                   const auto seen = static_cast<double>(decoded[rgb[0]] + decoded[rgb[1]] + decoded[rgb[2]]);
                   light[static_cast<std::size_t>(row) * width + static_cast<std::size_t>(column)] = given;
                   if (std::max({rgb[0], rgb[1], rgb[2]}) >= kSaturated) {
                     return;
                   }
                   n += 1;
                   x += static_cast<double>(given);
                   y += seen;
                   xx += static_cast<double>(given * given);
                   xy += static_cast<double>(given) * seen;
                 });
  const double spread = n * xx - x * x;
  const double slope = spread > 0 ? (n * xy - x * y) / spread : 0;
  if (!(slope > 0)) {
    light.clear();
    return;
  }
  room = static_cast<float>(std::max((y / slope - x) / n, kLeastRoom * x / n));
  for (float& one : light) {
    one = one < 0 ? 0 : one + room;
  }
}

float ReferencePicture::Impl::light_at(const Vector2f& at) const {
  const auto width = static_cast<std::size_t>(picture.width_px);
  const auto left = static_cast<std::size_t>(at.x());
  const auto top = static_cast<std::size_t>(at.y());
  const float u = at.x() - static_cast<float>(left);
  const float v = at.y() - static_cast<float>(top);
  const float* upper = light.data() + top * width + left;
  const float* lower = upper + width;
  if (!(upper[0] > 0) || !(upper[1] > 0) || !(lower[0] > 0) || !(lower[1] > 0)) {
    return 0;
  }
  return (upper[0] * (1 - u) + upper[1] * u) * (1 - v) + (lower[0] * (1 - u) + lower[1] * u) * v;
}

ReferencePicture::ReferencePicture(const capture::Lens& lens, Frame picture,
                                   const mesh::Vertices& vertices_mm, const Eigen::Matrix3Xf& normals,
                                   const mesh::Triangles& triangles, const std::vector<std::uint8_t>& visible,
                                   const ProjectedLight& light)
    : impl_(std::make_unique<Impl>()) {
  impl_->lens = lens;
  impl_->picture = std::move(picture);
  impl_->triangles = triangles;
  impl_->pixels = project_all(lens, vertices_mm, visible);
  if (light.is_known()) {
    impl_->look_at_light(vertices_mm, normals, light);
  }
}
ReferencePicture::~ReferencePicture() = default;
ReferencePicture::ReferencePicture(ReferencePicture&& other) noexcept = default;

Frame ReferencePicture::draw(const Frame& now, const mesh::Vertices& vertices_mm,
                             const Eigen::Matrix3Xf& normals, const std::vector<std::uint8_t>& visible,
                             const ProjectedLight& light, std::vector<std::uint8_t>& drawn) const {
  const std::size_t stride = 4 * static_cast<std::size_t>(now.width_px);
  auto pixels = std::make_shared<std::uint8_t[]>(stride * static_cast<std::size_t>(now.height_px));
  for (int y = 0; y < now.height_px; ++y) {
    std::memcpy(pixels.get() + static_cast<std::size_t>(y) * stride, now.row(y), stride);
  }
  drawn.assign(static_cast<std::size_t>(now.width_px) * static_cast<std::size_t>(now.height_px), 0);
  const std::vector<Vector3f> to = project_all(impl_->lens, vertices_mm, visible);
  for_each_pixel(impl_->triangles, to, now.width_px, now.height_px,
                 [&](int x, int y, const auto& corners, const Vector3f& weights) {
                   Vector2f source(0, 0);
                   for (Eigen::Index i = 0; i < 3; ++i) {
                     source += weights[i] * impl_->pixels[static_cast<std::size_t>(corners[i])].head<2>();
                   }
                   std::array<float, 3> rgb{};
                   std::uint8_t& known =
                       drawn[static_cast<std::size_t>(y) * static_cast<std::size_t>(now.width_px) +
                             static_cast<std::size_t>(x)];
                   known = 0;
                   if (!source.allFinite() || !sample(impl_->picture, source, rgb)) {
                     return;
                   }
                   float gain = 1;
                   if (!impl_->light.empty()) {
                     gain = (impl_->room + light.at(between(vertices_mm, corners, weights),
                                                    between(normals, corners, weights).normalized())) /
                            impl_->light_at(source);
                     if (!(gain > 1 / kMostGain && gain < kMostGain)) {
                       return;  // too dark to tell, or at the rim of what was seen
                     }
                   }
                   std::uint8_t* pixel =
                       pixels.get() + static_cast<std::size_t>(y) * stride + 4 * static_cast<std::size_t>(x);
                   for (std::size_t c = 0; c < 3; ++c) {
                     pixel[c] = relit(rgb[c], gain);
                   }
                   known = 1;
                 });
  Frame result = now;
  result.stride_bytes = stride;
  result.pixels = std::move(pixels);
  return result;
}

}  // namespace facet::fit
