#include "booth/face_in_space.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "render/renderer.hpp"

namespace facet::booth {
namespace {

/// Every so many pixels of a depth map become a vertex.
constexpr int kStride_px = 2;
/// Neighbours farther apart in depth than this are two surfaces.
constexpr float kMostStep_mm = 6;
constexpr float kLeastConfidence = 0.3F;
constexpr double kAgree_mm = 8;
/// Cosine between a line of sight and the skin's normal: seen at a flatter angle the net puts landmarks on
/// the outline, or past it.
constexpr double kLeastFacing = 0.5;

struct Surface {
  mesh::Vertices vertices_mm;  ///< rig frame
  mesh::Triangles triangles;
};

/// The depth maps as triangles, holes and steps left out.
Surface surface_of(std::span<const capture::DepthMap> maps) {
  std::vector<Eigen::Vector3f> vertices;
  std::vector<Eigen::Vector3i> triangles;
  for (const capture::DepthMap& map : maps) {
    const int columns = map.width_px / kStride_px;
    const int rows = map.height_px / kStride_px;
    const auto first = static_cast<int>(vertices.size());
    const Eigen::Isometry3d rig_from_map = map.lens.camera_from_rig.inverse();
    const auto depth = [&](int column, int row) {
      return map
          .depth_mm[static_cast<std::size_t>(row * kStride_px) * static_cast<std::size_t>(map.width_px) +
                    static_cast<std::size_t>(column * kStride_px)];
    };
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        const Eigen::Vector3d direction((column * kStride_px - map.lens.cx_px) / map.lens.fx_px,
                                        (row * kStride_px - map.lens.cy_px) / map.lens.fy_px, 1);
        vertices.emplace_back(
            (rig_from_map * (static_cast<double>(depth(column, row)) * direction)).cast<float>());
      }
    }
    const auto add = [&](int a, int b, int c) {
      const std::array corners{a, b, c};
      const auto of = [&](int corner) { return depth(corner % columns, corner / columns); };
      const auto [least, most] = std::minmax({of(a), of(b), of(c)});
      if (least > 0 && most - least < kMostStep_mm) {
        triangles.emplace_back(first + corners[0], first + corners[1], first + corners[2]);
      }
    };
    for (int row = 0; row + 1 < rows; ++row) {
      for (int column = 0; column + 1 < columns; ++column) {
        const int at = row * columns + column;
        add(at, at + columns, at + 1);
        add(at + 1, at + columns, at + columns + 1);
      }
    }
  }
  Surface surface;
  surface.vertices_mm.resize(3, static_cast<Eigen::Index>(vertices.size()));
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    surface.vertices_mm.col(static_cast<Eigen::Index>(i)) = vertices[i];
  }
  surface.triangles.resize(3, static_cast<Eigen::Index>(triangles.size()));
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    surface.triangles.col(static_cast<Eigen::Index>(i)) = triangles[i];
  }
  return surface;
}

struct Sight {
  Eigen::Vector3d at_mm;
  double confidence = 0;
};

/// The mean of the sights that agree with the surest one.
Eigen::Vector3d join(std::span<const Sight> sights) {
  const auto surest = std::max_element(sights.begin(), sights.end(), [](const Sight& a, const Sight& b) {
    return a.confidence < b.confidence;
  });
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double total = 0;
  for (const Sight& sight : sights) {
    if ((sight.at_mm - surest->at_mm).norm() < kAgree_mm) {
      sum += sight.confidence * sight.at_mm;
      total += sight.confidence;
    }
  }
  return sum / total;
}

}  // namespace

std::vector<fit::Correspondence> landmarks_in_space(std::span<const SeenLandmarks> views,
                                                    std::span<const capture::DepthMap> maps,
                                                    std::span<const face::LandmarkAnchor> anchors) {
  const Surface surface = surface_of(maps);
  std::vector<fit::Correspondence> found;
  if (surface.triangles.cols() == 0) {
    return found;
  }
  const render::Raycaster caster(surface.vertices_mm, surface.triangles, render::Raycaster::Build::Quick);
  std::vector<Sight> sights;
  for (std::size_t i = 0; i < anchors.size(); ++i) {
    const face::LandmarkAnchor& anchor = anchors[i];
    if (anchor.weights[0] + anchor.weights[1] + anchor.weights[2] < 0.5F) {
      continue;
    }
    sights.clear();
    for (const SeenLandmarks& view : views) {
      const auto column = static_cast<Eigen::Index>(i);
      const float confidence = view.face->confidence[column];
      const auto direction = view.lens->direction(view.face->points_px.col(column).head<2>().cast<double>());
      if (confidence < kLeastConfidence || !direction) {
        continue;
      }
      const Eigen::Vector3d origin = view.lens->centre_mm();
      const Eigen::Vector3d ray = (view.lens->camera_from_rig.linear().transpose() * *direction).normalized();
      const render::Raycaster::Hit hit = caster.first_hit(origin.cast<float>(), ray.cast<float>());
      if (hit.triangle < 0) {
        continue;
      }
      const auto corner = [&](int k) {
        return surface.vertices_mm.col(surface.triangles(k, hit.triangle)).cast<double>().eval();
      };
      const Eigen::Vector3d normal = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
      const double facing = std::abs(normal.dot(ray));
      if (facing >= kLeastFacing || view.by_hand) {
        sights.push_back({origin + static_cast<double>(hit.distance_mm) * ray, confidence * facing * facing});
      }
    }
    if (!sights.empty()) {
      found.push_back({anchor, join(sights)});
    }
  }
  return found;
}

}  // namespace facet::booth
