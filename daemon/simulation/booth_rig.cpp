#include "simulation/booth_rig.hpp"

#include <array>
#include <cmath>
#include <numbers>

#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector3d;

constexpr double kDegree = std::numbers::pi / 180;
constexpr std::uint64_t kStream = 91;
constexpr double kAimDepth_mm = -30;  // behind the face's middle: cheeks lie there

/// Where a device stands, seen from the face: azimuth to the subject's left, elevation up.
struct Plan {
  const char* name;
  double azimuth_deg;
  double elevation_deg;
};

constexpr std::array<Plan, 6> kCameras{{{"left-l", -36, -3},
                                        {"left-r", -20, -3},
                                        {"right-l", 20, -3},
                                        {"right-r", 36, -3},
                                        {"colour-l", -15, 14},
                                        {"colour-r", 15, 14}}};
constexpr std::size_t kFirstColour = 4;
constexpr std::array<Plan, 2> kProjectors{{{"projector-l", -28, 17}, {"projector-r", 28, 17}}};

/// Evenly from -spread to spread.
double jitter(Random& random, double spread) {
  return spread * static_cast<double>(random.uniform(-1, 1));
}

/// Turned to the face (give or take aim_mm), upright (give or take a degree).
Eigen::Isometry3d look_at_face(const Plan& plan, double distance_mm, double aim_mm, Random& random) {
  const double azimuth = (plan.azimuth_deg + jitter(random, 0.5)) * kDegree;
  const double elevation = (plan.elevation_deg + jitter(random, 0.5)) * kDegree;
  const Vector3d place_mm = (distance_mm + jitter(random, 12)) *
                            Vector3d(std::sin(azimuth) * std::cos(elevation), std::sin(elevation),
                                     std::cos(azimuth) * std::cos(elevation));
  const double aim_x_mm = jitter(random, aim_mm);
  const double aim_y_mm = jitter(random, aim_mm);
  const Vector3d forward = (Vector3d(aim_x_mm, aim_y_mm, kAimDepth_mm) - place_mm).normalized();
  const Vector3d right = forward.cross(Vector3d::UnitY()).normalized();
  Eigen::Matrix3d camera_from_rig_axes;
  camera_from_rig_axes.row(0) = right;
  camera_from_rig_axes.row(1) = forward.cross(right);
  camera_from_rig_axes.row(2) = forward;
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = Eigen::AngleAxisd(jitter(random, 1) * kDegree, Vector3d::UnitZ()) * camera_from_rig_axes;
  pose.translation() = -pose.linear() * place_mm;
  return pose;
}

capture::Lens make_camera_lens(const Plan& plan, Random& random) {
  capture::Lens lens;
  lens.width_px = 640;
  lens.height_px = 480;
  lens.fx_px = 1600 * (1 + jitter(random, 0.01));
  lens.fy_px = lens.fx_px * (1 + jitter(random, 0.001));
  lens.cx_px = 319.5 + jitter(random, 6);
  lens.cy_px = 239.5 + jitter(random, 6);
  lens.distortion.k1 = -0.12 + jitter(random, 0.03);
  lens.distortion.k2 = 0.08 + jitter(random, 0.04);
  lens.distortion.p1 = jitter(random, 0.0005);
  lens.distortion.p2 = jitter(random, 0.0005);
  lens.camera_from_rig = look_at_face(plan, 1000, 6, random);
  return lens;
}

/// The same view in more or fewer pixels. A pixel's centre is at whole numbers.
capture::Lens at_resolution(capture::Lens lens, double resolution) {
  lens.width_px = static_cast<int>(std::lround(lens.width_px * resolution));
  lens.height_px = static_cast<int>(std::lround(lens.height_px * resolution));
  lens.fx_px *= resolution;
  lens.fy_px *= resolution;
  lens.cx_px = (lens.cx_px + 0.5) * resolution - 0.5;
  lens.cy_px = (lens.cy_px + 0.5) * resolution - 0.5;
  return lens;
}

capture::Lens make_projector_lens(const Plan& plan, Random& random) {
  capture::Lens lens;
  lens.width_px = 1024;
  lens.height_px = 768;
  lens.fx_px = 2060 * (1 + jitter(random, 0.01));
  lens.fy_px = lens.fx_px;
  lens.cx_px = 511.5 + jitter(random, 8);
  lens.cy_px = 383.5 + jitter(random, 8);
  lens.distortion.k1 = jitter(random, 0.02);
  lens.camera_from_rig = look_at_face(plan, 1050, 8, random);
  return lens;
}

}  // namespace

capture::Rig make_booth_rig(std::uint64_t seed, double resolution) {
  Random random(seed, kStream);
  capture::Rig rig;
  for (const Plan& plan : kCameras) {
    rig.cameras.push_back({plan.name, at_resolution(make_camera_lens(plan, random), resolution),
                           rig.cameras.size() >= kFirstColour});
  }
  rig.pairs = {{0, 1}, {2, 3}};
  for (const Plan& plan : kProjectors) {
    rig.projectors.push_back({plan.name, make_projector_lens(plan, random)});
  }
  return rig;
}

}  // namespace facet::simulation
