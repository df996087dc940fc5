#include "simulation/look_picture.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace facet::simulation {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

/// Marks the pixels that a strand may touch, a pixel wide round them: [height_px][width_px].
std::vector<std::uint8_t> strand_pixels(const CameraIntrinsics& camera, const render::Strands& strands) {
  std::vector<std::uint8_t> marked(
      static_cast<std::size_t>(camera.width_px) * static_cast<std::size_t>(camera.height_px), 0);
  const auto place = [&](std::uint32_t point) {
    const auto at = strands.points.col(point);
    const float z = std::max(at.z(), 1.0F);
    return Vector2f(camera.fx * at.x() / z + camera.cx, camera.fy * at.y() / z + camera.cy);
  };
  for (const std::uint32_t first : strands.segments) {
    const Vector2f a = place(first);
    const Vector2f b = place(first + 1);
    const int steps = static_cast<int>(std::min((b - a).cwiseAbs().maxCoeff(), 2000.0F)) + 1;
    for (int step = 0; step <= steps; ++step) {
      const Vector2f at = a + static_cast<float>(step) / static_cast<float>(steps) * (b - a);
      const int x = static_cast<int>(std::lround(at.x()));
      const int y = static_cast<int>(std::lround(at.y()));
      for (int row = std::max(y - 1, 0); row <= std::min(y + 1, camera.height_px - 1); ++row) {
        for (int column = std::max(x - 1, 0); column <= std::min(x + 1, camera.width_px - 1); ++column) {
          marked[static_cast<std::size_t>(row) * static_cast<std::size_t>(camera.width_px) +
                 static_cast<std::size_t>(column)] = 1;
        }
      }
    }
  }
  return marked;
}

}  // namespace

PictureRays::PictureRays(const CameraIntrinsics& camera, const render::Raycaster& surfaces,
                         const render::StrandCaster& strands, int rays_per_pixel)
    : rows_(static_cast<std::size_t>(camera.height_px)) {
  constexpr int kMoreOnStrands = 2;
  const std::vector<std::uint8_t> with_strands = strand_pixels(camera, strands.strands());
  const std::vector<Vector2f> few = render::sample_offsets_px(rays_per_pixel);
  const std::vector<Vector2f> many = render::sample_offsets_px(kMoreOnStrands * rays_per_pixel);
  render::for_each_row(camera.height_px, [&](int y) {
    std::vector<Sample>& row = rows_[static_cast<std::size_t>(y)];
    for (int x = 0; x < camera.width_px; ++x) {
      const std::int32_t pixel = y * camera.width_px + x;
      const bool hairy = with_strands[static_cast<std::size_t>(pixel)] != 0;
      const std::vector<Vector2f>& offsets = hairy ? many : few;
      for (const Vector2f& offset : offsets) {
        const Vector3f direction = Vector3f((static_cast<float>(x) + offset.x() - camera.cx) / camera.fx,
                                            (static_cast<float>(y) + offset.y() - camera.cy) / camera.fy, 1)
                                       .normalized();
        const render::Raycaster::Hit hit = surfaces.first_hit(Vector3f::Zero(), direction);
        Sample sample{pixel, hit.triangle, -1, hit.barycentric, 1.0F / static_cast<float>(offsets.size())};
        if (hairy) {
          const float reach = hit.triangle >= 0 ? hit.distance_mm : std::numeric_limits<float>::infinity();
          const render::StrandCaster::Hit strand = strands.first_hit(Vector3f::Zero(), direction, reach);
          if (strand.segment >= 0) {
            sample.triangle = -1;
            sample.segment = strand.segment;
            sample.barycentric = {strand.along, 0};
          }
        }
        if (sample.triangle >= 0 || sample.segment >= 0) {
          row.push_back(sample);
        }
      }
    }
  });
}

std::vector<std::uint8_t> PictureRays::seen_vertices(const mesh::Triangles& triangles,
                                                     Eigen::Index vertex_count) const {
  std::vector<std::uint8_t> seen(static_cast<std::size_t>(vertex_count), 0);
  for (const std::vector<Sample>& row : rows_) {
    for (const Sample& sample : row) {
      if (sample.triangle >= 0) {
        for (const std::int32_t corner : triangles.col(sample.triangle)) {
          seen[static_cast<std::size_t>(corner)] = 1;
        }
      }
    }
  }
  std::vector<std::uint8_t> wider = seen;
  for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
    const auto corners = triangles.col(t);
    if (seen[static_cast<std::size_t>(corners[0])] != 0 || seen[static_cast<std::size_t>(corners[1])] != 0 ||
        seen[static_cast<std::size_t>(corners[2])] != 0) {
      for (const std::int32_t corner : corners) {
        wider[static_cast<std::size_t>(corner)] = 1;
      }
    }
  }
  return wider;
}

std::vector<std::uint8_t> PictureRays::seen_strands(const render::Strands& strands,
                                                    const std::vector<std::int32_t>& first) const {
  std::vector<std::uint8_t> seen(first.empty() ? 0 : first.size() - 1, 0);
  for (const std::vector<Sample>& row : rows_) {
    for (const Sample& sample : row) {
      if (sample.segment >= 0) {
        const auto point =
            static_cast<std::int32_t>(strands.segments[static_cast<std::size_t>(sample.segment)]);
        const auto after = std::upper_bound(first.begin(), first.end(), point);
        seen[static_cast<std::size_t>(after - first.begin()) - 1] = 1;
      }
    }
  }
  return seen;
}

Eigen::Matrix3Xf PictureRays::picture(const mesh::Triangles& triangles, const Eigen::Matrix3Xf& colours,
                                      const render::Strands& strands, const Eigen::Matrix3Xf& strand_colours,
                                      const Eigen::Matrix3Xf& background) const {
  Eigen::Matrix3Xf image = background;
  render::for_each_row(static_cast<int>(rows_.size()), [&](int y) {
    for (const Sample& sample : rows_[static_cast<std::size_t>(y)]) {
      Vector3f colour;
      if (sample.triangle >= 0) {
        colour = render::interpolate(triangles, sample.triangle, sample.barycentric, colours);
      } else {
        const Eigen::Index point = strands.segments[static_cast<std::size_t>(sample.segment)];
        colour = strand_colours.col(point) +
                 sample.barycentric.x() * (strand_colours.col(point + 1) - strand_colours.col(point));
      }
      image.col(sample.pixel) += sample.share * (colour - background.col(sample.pixel));
    }
  });
  return image;
}

}  // namespace facet::simulation
