#include "stereo/rectification.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "facet/error.hpp"

namespace facet::stereo {
namespace {

const capture::RigCamera& camera_of(const capture::Rig& rig, std::size_t index) {
  if (index >= rig.cameras.size()) {
    throw Error(ErrorKind::Usage, fmt::format("a stereo pair names camera {} of a rig of {} cameras", index,
                                              rig.cameras.size()));
  }
  return rig.cameras[index];
}

/// What a lens sees at a pixel, as a ray direction in the rectified frame; z > 0.
Eigen::Vector3d pinhole_direction(const capture::Lens& lens, const Eigen::Vector2d& pixel) {
  return {(pixel.x() - lens.cx_px) / lens.fx_px, (pixel.y() - lens.cy_px) / lens.fy_px, 1};
}

}  // namespace

Rectification::Rectification(const capture::Rig& rig, const capture::StereoPair& pair,
                             const DepthRange& depths, int width_px, int height_px) {
  const capture::RigCamera& left = camera_of(rig, pair.left);
  const capture::RigCamera& right = camera_of(rig, pair.right);
  const auto refuse = [&](const std::string& why) {
    throw Error(ErrorKind::Usage, fmt::format("stereo pair {} - {}: {}", left.name, right.name, why));
  };
  if (!(depths.nearest_mm > 0 && depths.nearest_mm < depths.farthest_mm)) {
    refuse(fmt::format("depths from {} to {} mm are no range", depths.nearest_mm, depths.farthest_mm));
  }
  if (width_px < 1 || height_px < 1) {
    refuse(fmt::format("rectified pictures of {} x {} px", width_px, height_px));
  }
  left_camera_ = left.lens;
  right_camera_ = right.lens;
  const Eigen::Vector3d between = right.lens.centre_mm() - left.lens.centre_mm();
  baseline_mm_ = between.norm();
  if (!(baseline_mm_ > 1e-3)) {
    refuse("both cameras stand in the same place");
  }

  // Rows of the rotation: x along the baseline, z as near as can be to where both look.
  const Eigen::Matrix3d rig_from_left = left.lens.camera_from_rig.linear().transpose();
  const Eigen::Matrix3d rig_from_right = right.lens.camera_from_rig.linear().transpose();
  const Eigen::Vector3d x = between / baseline_mm_;
  const Eigen::Vector3d looking = (rig_from_left.col(2) + rig_from_right.col(2)).normalized();
  if (rig_from_left.col(2).dot(rig_from_right.col(2)) < std::cos(std::numbers::pi / 3)) {
    refuse("the cameras look apart by more than 60 degrees");
  }
  const Eigen::Vector3d across = looking - looking.dot(x) * x;
  if (across.norm() < 0.5) {
    refuse("the cameras look along their baseline");
  }
  if (x.dot(rig_from_left.col(0) + rig_from_right.col(0)) < 0) {
    refuse("the right camera stands to the left of the left one; are they swapped?");
  }
  const Eigen::Vector3d z = across.normalized();
  Eigen::Matrix3d rectified_from_rig;
  rectified_from_rig << x.transpose(), z.cross(x).transpose(), z.transpose();

  const double focal = (left.lens.fx_px + left.lens.fy_px + right.lens.fx_px + right.lens.fy_px) / 4 *
                       width_px / left.lens.width_px;
  const auto pinhole = [&](const Eigen::Vector3d& centre) {
    capture::Lens lens;
    lens.width_px = width_px;
    lens.height_px = height_px;
    lens.fx_px = lens.fy_px = focal;
    lens.camera_from_rig.linear() = rectified_from_rig;
    lens.camera_from_rig.translation() = -rectified_from_rig * centre;
    return lens;
  };
  left_ = pinhole(left.lens.centre_mm());
  right_ = pinhole(right.lens.centre_mm());

  // The point that both should have in their middle: between the two optical axes, at the middle of the
  // disparities.
  const double middle_depth =
      2 / (1 / static_cast<double>(depths.nearest_mm) + 1 / static_cast<double>(depths.farthest_mm));
  const auto on_axis = [&](const capture::Lens& camera, const Eigen::Matrix3d& rig_from_camera) {
    const Eigen::Vector3d axis = rectified_from_rig * rig_from_camera.col(2);
    return Eigen::Vector3d(left_.camera_from_rig * camera.centre_mm() + axis * (middle_depth / axis.z()));
  };
  const Eigen::Vector3d middle =
      (on_axis(left.lens, rig_from_left) + on_axis(right.lens, rig_from_right)) / 2;
  left_.cx_px = (width_px - 1) / 2.0 - focal * middle.x() / middle_depth;
  right_.cx_px = (width_px - 1) / 2.0 - focal * (middle.x() - baseline_mm_) / middle_depth;
  left_.cy_px = right_.cy_px = (height_px - 1) / 2.0 - focal * middle.y() / middle_depth;
  // d = x_left - x_right = f B / depth + cx_left - cx_right
  offset_px_ = right_.cx_px - left_.cx_px;
  least_disparity_px_ = static_cast<int>(std::floor(disparity_px(static_cast<double>(depths.farthest_mm))));
  most_disparity_px_ = static_cast<int>(std::ceil(disparity_px(static_cast<double>(depths.nearest_mm))));
}

std::vector<Eigen::Vector2f> Rectification::sources(const capture::Lens& rectified,
                                                    const capture::Lens& lens) const {
  std::vector<Eigen::Vector2f> out;
  out.reserve(static_cast<std::size_t>(rectified.width_px) * static_cast<std::size_t>(rectified.height_px));
  const Eigen::Matrix3d rig_from_rectified = rectified.camera_from_rig.linear().transpose();
  for (int y = 0; y < rectified.height_px; ++y) {
    for (int x = 0; x < rectified.width_px; ++x) {
      const Eigen::Vector3d direction = rig_from_rectified * pinhole_direction(rectified, {x, y});
      const auto pixel = lens.project(lens.centre_mm() + direction);
      const bool seen = pixel && pixel->x() >= 0 && pixel->y() >= 0 && pixel->x() <= lens.width_px - 1 &&
                        pixel->y() <= lens.height_px - 1;
      out.emplace_back(seen ? Eigen::Vector2f(pixel->cast<float>()) : Eigen::Vector2f(-1, -1));
    }
  }
  return out;
}

std::vector<Eigen::Vector2f> Rectification::left_sources() const {
  return sources(left_, left_camera_);
}
std::vector<Eigen::Vector2f> Rectification::right_sources() const {
  return sources(right_, right_camera_);
}

std::optional<Eigen::Vector2d> Rectification::left_picture_px(const Eigen::Vector2d& rectified_px) const {
  return left_camera_.project(point_mm(rectified_px, 1));
}

Eigen::Vector3d Rectification::point_mm(const Eigen::Vector2d& rectified_px, double depth) const {
  return left_.camera_from_rig.inverse() * Eigen::Vector3d(pinhole_direction(left_, rectified_px) * depth);
}

}  // namespace facet::stereo
