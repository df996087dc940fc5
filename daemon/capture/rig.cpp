#include "capture/rig.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "facet/error.hpp"

namespace facet::capture {

namespace {

/// Distorted from undistorted normalised coordinates, and its derivative.
Eigen::Vector2d distort(const LensDistortion& lens, const Eigen::Vector2d& at, Eigen::Matrix2d* derivative) {
  const double x = at.x();
  const double y = at.y();
  const double r2 = x * x + y * y;
  const double radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3));
  if (derivative != nullptr) {
    const double slope = 2 * (lens.k1 + r2 * (2 * lens.k2 + r2 * 3 * lens.k3));  // d radial / d r2, times 2
    const double cross = slope * x * y + 2 * lens.p1 * x + 2 * lens.p2 * y;
    *derivative << radial + slope * x * x + 2 * lens.p1 * y + 6 * lens.p2 * x, cross, cross,
        radial + slope * y * y + 6 * lens.p1 * y + 2 * lens.p2 * x;
  }
  return {x * radial + 2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x),
          y * radial + lens.p1 * (r2 + 2 * y * y) + 2 * lens.p2 * x * y};
}

}  // namespace

std::optional<Eigen::Vector2d> Lens::project(const Eigen::Vector3d& point_mm) const {
  const Eigen::Vector3d seen = camera_from_rig * point_mm;
  if (!(seen.z() > 0)) {
    return std::nullopt;
  }
  const Eigen::Vector2d at = distort(distortion, seen.head<2>() / seen.z(), nullptr);
  return Eigen::Vector2d(fx_px * at.x() + cx_px, fy_px * at.y() + cy_px);
}

std::optional<Eigen::Vector3d> Lens::direction(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d wanted((pixel.x() - cx_px) / fx_px, (pixel.y() - cy_px) / fy_px);
  Eigen::Vector2d at = wanted;
  for (int step = 0; step < 20; ++step) {
    Eigen::Matrix2d derivative;
    const Eigen::Vector2d miss = distort(distortion, at, &derivative) - wanted;
    if (!(derivative.determinant() > 1e-3)) {
      return std::nullopt;  // beyond where the model turns back
    }
    if (miss.norm() * std::max(fx_px, fy_px) < 1e-9) {
      return Eigen::Vector3d(at.x(), at.y(), 1);
    }
    at -= derivative.inverse() * miss;
  }
  return std::nullopt;
}

CameraIntrinsics pinhole_of(const Lens& lens) {
  return {static_cast<float>(lens.fx_px),
          static_cast<float>(lens.fy_px),
          static_cast<float>(lens.cx_px),
          static_cast<float>(lens.cy_px),
          lens.width_px,
          lens.height_px};
}

std::optional<std::size_t> find_camera(const Rig& rig, std::string_view name) {
  const auto at = std::find_if(rig.cameras.begin(), rig.cameras.end(),
                               [&](const RigCamera& camera) { return camera.name == name; });
  return at != rig.cameras.end() ? std::optional(static_cast<std::size_t>(at - rig.cameras.begin()))
                                 : std::nullopt;
}

bool has_light(const Rig& rig, std::string_view name) {
  const auto named = [name](const auto& one) { return one.name == name; };
  return std::any_of(rig.projectors.begin(), rig.projectors.end(), named) ||
         std::any_of(rig.lights.begin(), rig.lights.end(), named);
}

const RigCamera& camera_named(const Rig& rig, const std::filesystem::path& rig_file, const std::string& name,
                              const std::string& advice) {
  if (const auto at = find_camera(rig, name)) {
    return rig.cameras[*at];
  }
  std::string known;
  for (const RigCamera& camera : rig.cameras) {
    known += (known.empty() ? "" : ", ") + camera.name;
  }
  throw Error(ErrorKind::Usage, fmt::format("the rig file '{}' has no camera '{}'; it has {}: {}",
                                            rig_file.string(), name, known, advice));
}

void check_size(const CameraInfo& camera, const RigCamera& known, const std::filesystem::path& rig_file) {
  const Lens& lens = known.lens;
  if (camera.width_px != lens.width_px || camera.height_px != lens.height_px) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("camera '{}' gives pictures of {} x {} px, the rig file '{}' has it calibrated at {} x "
                    "{}: give pictures of that size, or calibrate again",
                    known.name, camera.width_px, camera.height_px, rig_file.string(), lens.width_px,
                    lens.height_px));
  }
}

}  // namespace facet::capture
