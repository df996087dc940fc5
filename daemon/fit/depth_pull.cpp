#include "fit/depth_pull.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace facet::fit {

using capture::DepthMap;
using Eigen::Vector3f;

namespace {

constexpr float kSurfaceBreakMm = 4;  ///< between neighbouring pixels: two surfaces
constexpr float kSurfaceTwistMm = 1;  ///< of four pixels, off a plane

/// What a depth map says at a place between its pixels.
struct DepthSample {
  float depth_mm = 0;
  float slope_x = 0;  ///< mm per px
  float slope_y = 0;
  float confidence = 0;
};

std::optional<DepthSample> sample(const DepthMap& map, float x, float y) {
  if (!(x >= 0) || !(y >= 0) || !(x < static_cast<float>(map.width_px - 1)) ||
      !(y < static_cast<float>(map.height_px - 1))) {
    return std::nullopt;
  }
  const int left = static_cast<int>(x);
  const int top = static_cast<int>(y);
  const std::size_t at =
      static_cast<std::size_t>(top) * static_cast<std::size_t>(map.width_px) + static_cast<std::size_t>(left);
  const std::size_t below = at + static_cast<std::size_t>(map.width_px);
  const float a = map.depth_mm[at];
  const float b = map.depth_mm[at + 1];
  const float c = map.depth_mm[below];
  const float d = map.depth_mm[below + 1];
  if (!(a > 0) || !(b > 0) || !(c > 0) || !(d > 0) ||
      std::max({a, b, c, d}) - std::min({a, b, c, d}) > kSurfaceBreakMm ||
      std::abs(a - b - c + d) > kSurfaceTwistMm) {
    return std::nullopt;
  }
  const float u = x - static_cast<float>(left);
  const float v = y - static_cast<float>(top);
  DepthSample result;
  result.depth_mm = (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v;
  result.slope_x = (b - a) * (1 - v) + (d - c) * v;
  result.slope_y = (c - a) * (1 - u) + (d - b) * u;
  result.confidence = std::min(
      {map.confidence[at], map.confidence[at + 1], map.confidence[below], map.confidence[below + 1]});
  return result;
}

}  // namespace

Pinhole::Pinhole(const capture::Lens& lens)
    : rotation(lens.camera_from_rig.linear().cast<float>()),
      translation(lens.camera_from_rig.translation().cast<float>()),
      fx(static_cast<float>(lens.fx_px)),
      fy(static_cast<float>(lens.fy_px)),
      cx(static_cast<float>(lens.cx_px)),
      cy(static_cast<float>(lens.cy_px)) {}

std::optional<DepthPull> pull_of(const DepthMap& map, const Pinhole& camera, const Vector3f& point_mm,
                                 const Vector3f& normal, float sigma_mm) {
  const Vector3f at = camera.rotation * point_mm + camera.translation;
  if (!(at.z() > 1)) {
    return std::nullopt;
  }
  const float x = camera.fx * at.x() / at.z() + camera.cx;
  const float y = camera.fy * at.y() / at.z() + camera.cy;
  const auto depth = sample(map, x, y);
  if (!depth) {
    return std::nullopt;
  }
  DepthPull pull;
  pull.difference_mm = at.z() - depth->depth_mm;
  // The map's surface: z(x, y); its normal, towards the camera, from the two tangents.
  const float z = depth->depth_mm;
  const float px = (x - camera.cx) / camera.fx;
  const float py = (y - camera.cy) / camera.fy;
  const Vector3f along_x(depth->slope_x * px + z / camera.fx, depth->slope_x * py, depth->slope_x);
  const Vector3f along_y(depth->slope_y * px, depth->slope_y * py + z / camera.fy, depth->slope_y);
  const Vector3f map_normal = along_y.cross(along_x).normalized();
  pull.alike = map_normal.dot(camera.rotation * normal);
  // Along z a steep surface's error is longer than it is: what counts is the distance to the surface.
  pull.facing = std::max(0.0F, -map_normal.dot(at.normalized()));
  pull.weight = depth->confidence * std::max(0.0F, pull.alike) * pull.facing * pull.facing *
                tukey_weight(pull.difference_mm, sigma_mm);
  // d(z - Z(x, y)) by the point, camera frame: what the vertex passes over counts, too.
  const Vector3f slope(-depth->slope_x * camera.fx / at.z(), -depth->slope_y * camera.fy / at.z(),
                       1 + (depth->slope_x * (x - camera.cx) + depth->slope_y * (y - camera.cy)) / at.z());
  pull.jacobian = camera.rotation.transpose() * slope;
  return pull;
}

}  // namespace facet::fit
