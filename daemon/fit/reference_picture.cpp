#include "fit/reference_picture.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <optional>

namespace facet::fit {

using Eigen::Vector2f;

struct ReferencePicture::Impl {
  capture::Lens lens;
  Frame picture;
  mesh::Triangles triangles;
  std::vector<Vector2f> pixels;  ///< [vertex_count] where the reference shows a vertex; NaN where it does not
};

namespace {

constexpr float kNowhere = std::numeric_limits<float>::quiet_NaN();

std::vector<Vector2f> project_all(const capture::Lens& lens, const mesh::Vertices& vertices_mm,
                                  const std::vector<std::uint8_t>& visible) {
  std::vector<Vector2f> pixels(static_cast<std::size_t>(vertices_mm.cols()), Vector2f(kNowhere, kNowhere));
  for (std::size_t v = 0; v < pixels.size(); ++v) {
    if (visible[v] != 0) {
      if (const auto pixel = lens.project(vertices_mm.col(static_cast<Eigen::Index>(v)).cast<double>())) {
        pixels[v] = pixel->cast<float>();
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

}  // namespace

ReferencePicture::ReferencePicture(const capture::Lens& lens, Frame picture,
                                   const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles,
                                   const std::vector<std::uint8_t>& visible)
    : impl_(std::make_unique<Impl>()) {
  impl_->lens = lens;
  impl_->picture = std::move(picture);
  impl_->triangles = triangles;
  impl_->pixels = project_all(lens, vertices_mm, visible);
}
ReferencePicture::~ReferencePicture() = default;
ReferencePicture::ReferencePicture(ReferencePicture&& other) noexcept = default;

Frame ReferencePicture::draw(const Frame& now, const mesh::Vertices& vertices_mm,
                             const std::vector<std::uint8_t>& visible,
                             std::vector<std::uint8_t>& drawn) const {
  const std::size_t stride = 4 * static_cast<std::size_t>(now.width_px);
  auto pixels = std::make_shared<std::uint8_t[]>(stride * static_cast<std::size_t>(now.height_px));
  for (int y = 0; y < now.height_px; ++y) {
    std::memcpy(pixels.get() + static_cast<std::size_t>(y) * stride, now.row(y), stride);
  }
  drawn.assign(static_cast<std::size_t>(now.width_px) * static_cast<std::size_t>(now.height_px), 0);
  const std::vector<Vector2f> to = project_all(impl_->lens, vertices_mm, visible);
  for (Eigen::Index t = 0; t < impl_->triangles.cols(); ++t) {
    std::array<Vector2f, 3> target;
    std::array<Vector2f, 3> source;
    bool known = true;
    for (std::size_t i = 0; i < 3; ++i) {
      const auto vertex = static_cast<std::size_t>(impl_->triangles(static_cast<Eigen::Index>(i), t));
      target[i] = to[vertex];
      source[i] = impl_->pixels[vertex];
      known = known && target[i].allFinite() && source[i].allFinite();
    }
    if (!known) {
      continue;
    }
    const Vector2f a = target[1] - target[0];
    const Vector2f b = target[2] - target[0];
    const float area = a.x() * b.y() - a.y() * b.x();
    if (!(std::abs(area) > 1e-6F)) {
      continue;
    }
    const auto [least_x, most_x] = std::minmax({target[0].x(), target[1].x(), target[2].x()});
    const auto [least_y, most_y] = std::minmax({target[0].y(), target[1].y(), target[2].y()});
    const int x1 = std::min(now.width_px - 1, static_cast<int>(std::floor(most_x)));
    const int y1 = std::min(now.height_px - 1, static_cast<int>(std::floor(most_y)));
    for (int y = std::max(0, static_cast<int>(std::ceil(least_y))); y <= y1; ++y) {
      for (int x = std::max(0, static_cast<int>(std::ceil(least_x))); x <= x1; ++x) {
        const Vector2f at = Vector2f(static_cast<float>(x), static_cast<float>(y)) - target[0];
        const float w1 = (at.x() * b.y() - at.y() * b.x()) / area;
        const float w2 = (a.x() * at.y() - a.y() * at.x()) / area;
        std::array<float, 3> rgb{};
        if (w1 < 0 || w2 < 0 || w1 + w2 > 1 ||
            !sample(impl_->picture, source[0] + w1 * (source[1] - source[0]) + w2 * (source[2] - source[0]),
                    rgb)) {
          continue;
        }
        std::uint8_t* pixel =
            pixels.get() + static_cast<std::size_t>(y) * stride + 4 * static_cast<std::size_t>(x);
        for (std::size_t c = 0; c < 3; ++c) {
          pixel[c] = static_cast<std::uint8_t>(std::lround(rgb[c]));
        }
        drawn[static_cast<std::size_t>(y) * static_cast<std::size_t>(now.width_px) +
              static_cast<std::size_t>(x)] = 1;
      }
    }
  }
  Frame result = now;
  result.stride_bytes = stride;
  result.pixels = std::move(pixels);
  return result;
}

}  // namespace facet::fit
