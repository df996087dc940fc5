#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <thread>

#include "facet/error.hpp"
#include "maths/threads.hpp"
#include "render/renderer.hpp"

namespace facet::render {

void for_each_row(int row_count, const std::function<void(int)>& work) {
  maths::for_each_piece(static_cast<std::size_t>(std::max(row_count, 0)),
                        std::min(2U, std::thread::hardware_concurrency()),
                        [&](std::size_t, std::size_t y) { work(static_cast<int>(y)); });
}

Eigen::MatrixXf interpolate(const HitImage& hits, const mesh::Triangles& triangles,
                            const Eigen::Ref<const Eigen::MatrixXf>& field) {
  Eigen::MatrixXf values =
      Eigen::MatrixXf::Zero(field.rows(), static_cast<Eigen::Index>(hits.triangle.size()));
  for (std::size_t pixel = 0; pixel < hits.triangle.size(); ++pixel) {
    if (hits.triangle[pixel] < 0) {
      continue;
    }
    const auto corners = triangles.col(hits.triangle[pixel]);
    const Eigen::Vector2f& at = hits.barycentric[pixel];
    values.col(static_cast<Eigen::Index>(pixel)) = (1 - at.x() - at.y()) * field.col(corners[0]) +
                                                   at.x() * field.col(corners[1]) +
                                                   at.y() * field.col(corners[2]);
  }
  return values;
}

Eigen::Vector3f interpolate(const mesh::Triangles& triangles, std::int32_t triangle,
                            const Eigen::Vector2f& barycentric, const mesh::Vertices& field) {
  const auto corners = triangles.col(triangle);
  return (1 - barycentric.x() - barycentric.y()) * field.col(corners[0]) +
         barycentric.x() * field.col(corners[1]) + barycentric.y() * field.col(corners[2]);
}

std::vector<Eigen::Vector2f> sample_offsets_px(int count) {
  // The additive recurrence of the plastic number: the two-dimensional kin of the golden ratio.
  constexpr float kPlastic = 1.32471795724F;
  std::vector<Eigen::Vector2f> offsets;
  Eigen::Vector2f sum{0, 0};
  for (int k = 0; k < std::max(count, 1); ++k) {
    const float x = static_cast<float>(k) / kPlastic;
    const float y = static_cast<float>(k) / (kPlastic * kPlastic);
    offsets.emplace_back(x - std::floor(x), y - std::floor(y));
    sum += offsets.back();
  }
  for (auto& offset : offsets) {
    offset -= sum / static_cast<float>(offsets.size());
  }
  return offsets;
}

Picture render_surface(const Raycaster& surface, const CameraIntrinsics& camera, const SurfaceColour& colour,
                       const Picture& background, int rays_per_pixel) {
  if (camera.width_px != background.width_px || camera.height_px != background.height_px) {
    throw Error(ErrorKind::Internal,
                fmt::format("a camera of {}x{} px cannot render over a background of {}x{} px",
                            camera.width_px, camera.height_px, background.width_px, background.height_px));
  }
  const auto offsets = sample_offsets_px(rays_per_pixel);
  std::vector<HitImage> casts;
  casts.reserve(offsets.size());
  for (const auto& offset : offsets) {
    casts.push_back(surface.cast(camera, offset));
  }
  Picture picture = background;
  for_each_row(camera.height_px, [&](int y) {
    for (int x = 0; x < camera.width_px; ++x) {
      const std::size_t pixel = static_cast<std::size_t>(y) * static_cast<std::size_t>(camera.width_px) +
                                static_cast<std::size_t>(x);
      Eigen::Vector3f sum = Eigen::Vector3f::Zero();
      int hit_count = 0;
      for (const HitImage& hits : casts) {
        if (hits.triangle[pixel] >= 0) {
          sum += colour(hits.triangle[pixel], hits.barycentric[pixel]);
          ++hit_count;
        }
      }
      if (hit_count == 0) {
        continue;
      }
      const auto missed = static_cast<float>(static_cast<int>(casts.size()) - hit_count);
      for (int channel = 0; channel < 3; ++channel) {
        std::uint8_t& value = picture.rgb[3 * pixel + static_cast<std::size_t>(channel)];
        value = linear_to_srgb8((sum[channel] + missed * srgb8_to_linear(value)) /
                                static_cast<float>(casts.size()));
      }
    }
  });
  return picture;
}

Eigen::MatrixXf openness(const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles) {
  constexpr int kRays = 64;
  constexpr float kReach_mm = 25;
  constexpr float kLift_mm = 0.3F;
  const Raycaster caster(vertices_mm, triangles);
  Eigen::Matrix3Xf normals;
  mesh::vertex_normals(vertices_mm, triangles, normals);
  Eigen::MatrixXf open_part(1, vertices_mm.cols());
  for_each_row(static_cast<int>(vertices_mm.cols()), [&](int v) {
    const Eigen::Vector3f normal = normals.col(v);
    if (normal.isZero()) {  // a vertex of no triangle
      open_part(0, v) = 1;
      return;
    }
    const Eigen::Vector3f u = normal.unitOrthogonal();
    const Eigen::Vector3f w = normal.cross(u);
    const Eigen::Vector3f from = vertices_mm.col(v) + kLift_mm * normal;
    float open = 0;
    for (int ray = 0; ray < kRays; ++ray) {  // cosine-weighted, a spiral over the disc
      const float part = (static_cast<float>(ray) + 0.5F) / kRays;
      const float turn = static_cast<float>(ray) * 2.39996F;  // the golden angle
      const float radius = std::sqrt(part);
      const Eigen::Vector3f direction =
          radius * std::cos(turn) * u + radius * std::sin(turn) * w + std::sqrt(1 - part) * normal;
      open += caster.occluded(from, from + kReach_mm * direction, 0) ? 0.0F : 1.0F;
    }
    open_part(0, v) = open / kRays;
  });
  return open_part;
}

}  // namespace facet::render
