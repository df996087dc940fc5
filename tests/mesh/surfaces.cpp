#include "surfaces.hpp"

#include <cmath>
#include <map>
#include <numbers>
#include <tuple>

namespace facet::test {

namespace {

/// Fills what follows from quads and positions: x and y as texture coordinates and projections.
void finish(Surface& surface) {
  const auto count = static_cast<std::size_t>(surface.vertices_mm.cols());
  surface.control.vertex_count = static_cast<std::int32_t>(count);
  surface.control.texture_coordinates = surface.vertices_mm.topRows<2>();
  surface.control.refinable.assign(count, 1);
  surface.projected_px = surface.vertices_mm.topRows<2>();
  surface.facing.assign(count, 1);
}

}  // namespace

Surface plane(int columns, int rows, float spacing_mm) {
  Surface surface;
  const int stride = columns + 1;
  surface.vertices_mm.resize(3, stride * (rows + 1));
  for (int y = 0; y <= rows; ++y) {
    for (int x = 0; x <= columns; ++x) {
      surface.vertices_mm.col(y * stride + x) << static_cast<float>(x) * spacing_mm,
          static_cast<float>(y) * spacing_mm, 0.0F;
    }
  }
  surface.control.quads.resize(4, columns * rows);
  for (int y = 0; y < rows; ++y) {
    for (int x = 0; x < columns; ++x) {
      const int corner = y * stride + x;
      surface.control.quads.col(y * columns + x) << corner, corner + 1, corner + stride + 1, corner + stride;
    }
  }
  finish(surface);
  return surface;
}

Surface sphere(int cells, float radius_mm) {
  std::map<std::tuple<int, int, int>, std::int32_t> index_of;
  std::vector<Eigen::Vector3f> points;
  const auto index = [&](const Eigen::Vector3i& grid) {
    const auto [known, is_new] =
        index_of.try_emplace({grid[0], grid[1], grid[2]}, static_cast<std::int32_t>(points.size()));
    if (is_new) {
      // Equal angles rather than equal lengths make the cells nearly equal in size.
      const Eigen::Array3f angle =
          grid.cast<float>().array() / static_cast<float>(cells) * (std::numbers::pi_v<float> / 4.0F);
      points.push_back(angle.tan().matrix().normalized() * radius_mm);
    }
    return known->second;
  };
  Surface surface;
  surface.control.quads.resize(4, 6 * cells * cells);
  Eigen::Index quad = 0;
  for (int axis = 0; axis < 3; ++axis) {
    for (const int side : {-1, 1}) {
      for (int v = 0; v < cells; ++v) {
        for (int u = 0; u < cells; ++u) {
          const auto corner = [&](int du, int dv) {
            Eigen::Vector3i grid;
            grid[axis] = side * cells;
            grid[(axis + 1) % 3] = 2 * (u + du) - cells;
            grid[(axis + 2) % 3] = 2 * (v + dv) - cells;
            return index(grid);
          };
          if (side > 0) {
            surface.control.quads.col(quad++) << corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1);
          } else {
            surface.control.quads.col(quad++) << corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0);
          }
        }
      }
    }
  }
  surface.vertices_mm.resize(3, static_cast<Eigen::Index>(points.size()));
  for (std::size_t p = 0; p < points.size(); ++p) {
    surface.vertices_mm.col(static_cast<Eigen::Index>(p)) = points[p];
  }
  finish(surface);
  for (std::size_t p = 0; p < points.size(); ++p) {
    surface.facing[p] = points[p].z() > 0 ? 1 : 0;
  }
  return surface;
}

Surface tube(int around, int along, float radius_mm, float length_mm) {
  Surface surface;
  surface.vertices_mm.resize(3, around * (along + 1));
  for (int y = 0; y <= along; ++y) {
    for (int x = 0; x < around; ++x) {
      const float angle = 2 * std::numbers::pi_v<float> * static_cast<float>(x) / static_cast<float>(around);
      surface.vertices_mm.col(y * around + x) << radius_mm * std::cos(angle), radius_mm * std::sin(angle),
          length_mm * static_cast<float>(y) / static_cast<float>(along);
    }
  }
  surface.control.quads.resize(4, around * along);
  for (int y = 0; y < along; ++y) {
    for (int x = 0; x < around; ++x) {
      const int right = (x + 1) % around;
      surface.control.quads.col(y * around + x) << y * around + x, y * around + right,
          (y + 1) * around + right, (y + 1) * around + x;
    }
  }
  finish(surface);
  return surface;
}

}  // namespace facet::test
