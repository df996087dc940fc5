#include "booth/vertex_texture.hpp"

#include <bit>
#include <cmath>
#include <utility>

#include "fit/visibility.hpp"
#include "render/renderer.hpp"

namespace facet::booth {
namespace {

constexpr std::uint64_t kMostSlots = 64;
constexpr float kVisibleMargin_mm = 4;
constexpr float kRim_px = 2;

/// Linear RGB between four pixels; the point is inside the picture.
Eigen::Vector3f sample(const Frame& frame, const Eigen::Vector2d& at_px) {
  const int x = static_cast<int>(at_px.x());
  const int y = static_cast<int>(at_px.y());
  const auto right = static_cast<float>(at_px.x() - x);
  const auto down = static_cast<float>(at_px.y() - y);
  const auto pixel = [&](int column, int row) {
    const std::uint8_t* value = frame.row(row) + 4 * static_cast<std::size_t>(column);
    return Eigen::Vector3f(render::srgb8_to_linear(value[0]), render::srgb8_to_linear(value[1]),
                           render::srgb8_to_linear(value[2]));
  };
  return (1 - down) * ((1 - right) * pixel(x, y) + right * pixel(x + 1, y)) +
         down * ((1 - right) * pixel(x, y + 1) + right * pixel(x + 1, y + 1));
}

}  // namespace

void VertexTexture::begin(Eigen::Index vertex_count) {
  sums_.assign(static_cast<std::size_t>(vertex_count), Eigen::Vector4f::Zero());
  slots_ = 0;
  latest_.reset();
}

void VertexTexture::add(const capture::Lens& lens, const Frame& frame, const mesh::Vertices& vertices_mm,
                        const Eigen::Matrix3Xf& normals, const mesh::Triangles& triangles) {
  if (frame.empty() || frame.corrupt || frame.width_px != lens.width_px ||
      frame.height_px != lens.height_px || slots_ >= kMostSlots) {
    return;
  }
  fit::find_visible(lens, vertices_mm, normals, triangles, kVisibleMargin_mm, kRim_px, visible_);
  const Eigen::Vector3f centre_mm = lens.centre_mm().cast<float>();
  for (std::size_t v = 0; v < sums_.size(); ++v) {
    const auto column = static_cast<Eigen::Index>(v);
    const Eigen::Vector3f at_mm = vertices_mm.col(column);
    const auto at_px = visible_[v] != 0 ? lens.project(at_mm.cast<double>()) : std::nullopt;
    if (!at_px || !(at_px->minCoeff() >= 0) || !(at_px->x() < lens.width_px - 1) ||
        !(at_px->y() < lens.height_px - 1)) {
      continue;
    }
    const float cosine = std::max(0.0F, normals.col(column).dot((centre_mm - at_mm).normalized()));
    const float weight = cosine * cosine * cosine;
    sums_[v].head<3>() += weight * sample(frame, *at_px);
    sums_[v].w() += weight;
  }
}

void VertexTexture::publish() {
  ++slots_;
  if (slots_ > kMostSlots || !std::has_single_bit(slots_)) {
    return;
  }
  constexpr float kLeastWeight = 1e-3F;
  Eigen::Vector4f all = Eigen::Vector4f::Zero();
  for (const Eigen::Vector4f& sum : sums_) {
    all += sum;
  }
  const Eigen::Vector3f mean = all.head<3>() / std::max(all.w(), kLeastWeight);
  auto albedo = std::make_shared<mesh::Albedo>();
  albedo->version = ++version_;
  albedo->linear_rgb.reserve(3 * sums_.size());
  for (const Eigen::Vector4f& sum : sums_) {
    const Eigen::Vector3f colour = sum.w() > kLeastWeight ? Eigen::Vector3f(sum.head<3>() / sum.w()) : mean;
    albedo->linear_rgb.insert(albedo->linear_rgb.end(), colour.data(), colour.data() + 3);
  }
  latest_ = std::move(albedo);
}

}  // namespace facet::booth
