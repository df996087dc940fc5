#include "simulation/look_picture.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace facet::simulation {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

/// Where the points are seen, NaN where the lens does not say. [2][point_count]
Eigen::Matrix2Xf places_px(const Optics& optics, const Eigen::Matrix4Xf& points) {
  constexpr float kNowhere = std::numeric_limits<float>::quiet_NaN();
  Eigen::Matrix2Xf places(2, points.cols());
  for (Eigen::Index p = 0; p < points.cols(); ++p) {
    places.col(p) = optics.project(points.col(p).head<3>()).value_or(Vector2f(kNowhere, kNowhere));
  }
  return places;
}

/// Pixels that a strand may touch, a pixel wide round them: [height_px][width_px].
class StrandPixels {
 public:
  StrandPixels(const Optics& optics, const render::StrandCaster& caster)
      : width_px_(optics.width_px),
        height_px_(optics.height_px),
        marked_(static_cast<std::size_t>(width_px_) * static_cast<std::size_t>(height_px_), 0) {
    const std::vector<std::uint32_t>& segments = caster.strands().segments;
    Eigen::Matrix2Xf from = places_px(optics, caster.strands().points);
    mark(segments, from, from, false);
    for (const Eigen::Matrix4Xf& points : caster.later()) {
      const Eigen::Matrix2Xf to = places_px(optics, points);
      mark(segments, from, to, true);
      from = to;
    }
  }

  bool operator()(int x, int y) const { return marked_[index(x, y)] != 0; }

 private:
  static constexpr float kMost_px = 2000;  // of a line's or a path's pixels

  std::size_t index(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_px_) + static_cast<std::size_t>(x);
  }

  /// Marks all segments on their way between two moments; without the first moment where it is marked.
  void mark(const std::vector<std::uint32_t>& segments, const Eigen::Matrix2Xf& from,
            const Eigen::Matrix2Xf& to, bool first_is_marked) {
    for (const std::uint32_t first : segments) {
      const Vector2f a = from.col(first);
      const Vector2f b = from.col(first + 1);
      const Vector2f a_moves = to.col(first) - a;
      const Vector2f b_moves = to.col(first + 1) - b;
      if (!(a + b + a_moves + b_moves).allFinite()) {
        continue;
      }
      const float farthest = std::max(a_moves.cwiseAbs().maxCoeff(), b_moves.cwiseAbs().maxCoeff());
      const int steps = static_cast<int>(std::ceil(std::min(farthest, kMost_px)));
      for (int step = first_is_marked ? 1 : 0; step <= steps; ++step) {
        const float part = steps > 0 ? static_cast<float>(step) / static_cast<float>(steps) : 0.0F;
        mark_line(a + part * a_moves, b + part * b_moves);
      }
    }
  }

  void mark_line(const Vector2f& a, const Vector2f& b) {
    const int steps = static_cast<int>(std::min((b - a).cwiseAbs().maxCoeff(), kMost_px)) + 1;
    for (int step = 0; step <= steps; ++step) {
      const Vector2f at = a + static_cast<float>(step) / static_cast<float>(steps) * (b - a);
      const int x = static_cast<int>(std::lround(at.x()));
      const int y = static_cast<int>(std::lround(at.y()));
      for (int row = std::max(y - 1, 0); row <= std::min(y + 1, height_px_ - 1); ++row) {
        for (int column = std::max(x - 1, 0); column <= std::min(x + 1, width_px_ - 1); ++column) {
          marked_[index(column, row)] = 1;
        }
      }
    }
  }

  int width_px_;
  int height_px_;
  std::vector<std::uint8_t> marked_;
};

}  // namespace

PictureRays::PictureRays(const Optics& optics, const render::Raycaster& surfaces,
                         const render::StrandCaster& strands, int rays_per_pixel)
    : rows_(static_cast<std::size_t>(optics.height_px)) {
  constexpr int kMoreOnStrands = 2;
  const StrandPixels hairy_pixels(optics, strands);
  const std::vector<Vector2f> few = render::sample_offsets_px(rays_per_pixel);
  const std::vector<Vector2f> many = render::sample_offsets_px(kMoreOnStrands * rays_per_pixel);
  render::for_each_row(optics.height_px, [&](int y) {
    std::vector<Sample>& row = rows_[static_cast<std::size_t>(y)];
    std::vector<PictureRay> rays;
    for (int x = 0; x < optics.width_px; ++x) {
      const std::int32_t pixel = y * optics.width_px + x;
      const bool hairy = hairy_pixels(x, y);
      const std::vector<Vector2f>& offsets = hairy ? many : few;
      rays.resize(offsets.size());
      optics.look(x, y, offsets, rays);
      for (const PictureRay& ray : rays) {
        const render::Raycaster::Hit hit =
            surfaces.first_hit(Vector3f::Zero(), ray.direction, 0, false, ray.time);
        Sample sample{pixel, hit.triangle, -1, hit.barycentric, 1.0F / static_cast<float>(rays.size())};
        if (hairy) {
          const float reach = hit.triangle >= 0 ? hit.distance_mm : std::numeric_limits<float>::infinity();
          const render::StrandCaster::Hit strand =
              strands.first_hit(Vector3f::Zero(), ray.direction, reach, ray.time);
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
