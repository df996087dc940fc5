#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "capture/rig.hpp"
#include "facet/frame.hpp"

namespace facet::test {

/// A surface that moves, two cameras with distorted lenses that look at it and a projector that shows random
/// stripes on it, all of it exact: what a pixel sees is found by intersecting its ray. Link ROOMS capture.
struct StereoScene {
  enum class Surface {
    Plane,   ///< tilted
    Sphere,  ///< the near half of a ball of 90 mm radius in front of nothing
    Wave,    ///< waves of a few mm that travel while the whole moves, as skin does over a talking jaw
    Step,    ///< a plate 40 mm in front of another one: an edge with a surface that one camera alone sees
  };

  Surface surface = Surface::Wave;
  double speed_mm_per_slot = 1.5;  ///< towards the cameras, of the wave; 90 mm/s at 60 slots a second
  double noise = 0.008;            ///< standard deviation of a linear grey value at full light
  double ambient = 0.06;
  double right_gain = 0.85;  ///< the right camera's exposure
  double stripe_mm = 2;      ///< width of a stripe on the surface
  double fringe_mm = 0;  ///< above 0: fringes of that period in place of stripes, and light in blank slots
  int samples = 2;       ///< rays per pixel, across and down
  std::uint32_t seed = 1;

  capture::Rig rig;

  static constexpr double kDistance_mm = 750;
  static constexpr double kRadius_mm = 90;

  explicit StereoScene(int width_px = 640, int height_px = 480) {
    const double focal = 1250.0 * width_px / 640;
    const auto camera = [&](const char* name, const Eigen::Vector3d& at, double turn, double roll) {
      capture::RigCamera out;
      out.name = name;
      out.lens.width_px = width_px;
      out.lens.height_px = height_px;
      out.lens.fx_px = focal;
      out.lens.fy_px = focal * 1.002;
      out.lens.cx_px = width_px * 0.497;
      out.lens.cy_px = height_px * 0.508;
      out.lens.distortion = {-0.11, 0.06, 0.0004, -0.0006, 0};
      const Eigen::Isometry3d rig_from_camera = Eigen::Translation3d(at) *
                                                Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()) *
                                                Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ());
      out.lens.camera_from_rig = rig_from_camera.inverse();
      return out;
    };
    rig.cameras.push_back(camera("left", {-70, 4, 0}, 0.091, 0.006));
    rig.cameras.push_back(camera("right", {72, -3, 6}, -0.094, -0.008));
    rig.cameras.back().lens.fx_px *= 1.006;
    rig.cameras.back().lens.fy_px *= 1.006;
    rig.pairs.push_back({0, 1});
    capture::RigProjector projector;
    projector.name = "projector";
    projector.lens.width_px = 1024;
    projector.lens.height_px = 768;
    projector.lens.fx_px = projector.lens.fy_px = 1800;
    projector.lens.cx_px = 512;
    projector.lens.cy_px = 384;
    projector.lens.camera_from_rig =
        (Eigen::Translation3d(10, -140, 20) * Eigen::AngleAxisd(-0.19, Eigen::Vector3d::UnitX())).inverse();
    rig.projectors.push_back(projector);
  }

  /// Pattern A, pattern B, blank.
  static bool has_pattern(int slot) { return slot % 3 != 2; }
  /// Parts of a period, of the fringes: a quarter more from pattern to pattern.
  static double shift_turns(int slot) { return has_pattern(slot) ? (slot / 3 * 2 + slot % 3) % 4 / 4.0 : 0; }

  /// Depth z of the surface over the rig's x and y, where there is one.
  std::optional<double> height(double x, double y, int slot) const {
    switch (surface) {
      case Surface::Plane:
        return kDistance_mm + 0.25 * x - 0.15 * y;
      case Surface::Sphere: {
        const double square = kRadius_mm * kRadius_mm - x * x - y * y;
        return square > 0 ? std::optional(kDistance_mm + 30 - std::sqrt(square)) : std::nullopt;
      }
      case Surface::Wave:
        return kDistance_mm + 0.0012 * (x * x + y * y) +
               5 * std::sin(2 * std::numbers::pi * (x / 45 - 0.02 * slot)) *
                   std::cos(2 * std::numbers::pi * y / 60) -
               speed_mm_per_slot * slot;
      case Surface::Step:
        return x < 0 ? kDistance_mm : kDistance_mm - 40;
    }
    return std::nullopt;
  }

  /// Where a ray (origin, direction with z > 0) first meets the surface, rig frame.
  std::optional<Eigen::Vector3d> meet(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                                      int slot) const {
    const auto at_depth = [&](double z) {
      return Eigen::Vector3d(origin + direction * ((z - origin.z()) / direction.z()));
    };
    if (surface == Surface::Sphere) {
      const Eigen::Vector3d centre(0, 0, kDistance_mm + 30);
      const Eigen::Vector3d d = direction.normalized();
      const double along = d.dot(centre - origin);
      const double square = kRadius_mm * kRadius_mm - (centre - origin - along * d).squaredNorm();
      if (square <= 0) {
        return std::nullopt;
      }
      const Eigen::Vector3d point = origin + d * (along - std::sqrt(square));
      return point.z() < centre.z() ? std::optional(point) : std::nullopt;
    }
    if (surface == Surface::Step) {
      const Eigen::Vector3d near = at_depth(kDistance_mm - 40);
      return near.x() >= 0 ? near : at_depth(kDistance_mm);
    }
    // Slopes are well below those of the rays, so that z <- height(x(z), y(z)) contracts.
    double z = kDistance_mm;
    for (int step = 0; step < 40; ++step) {
      const Eigen::Vector3d point = at_depth(z);
      const double next = *height(point.x(), point.y(), slot);
      const double move = next - z;
      z = next;
      if (std::abs(move) < 1e-9) {
        break;
      }
    }
    return at_depth(z);
  }

  Eigen::Vector3d normal(const Eigen::Vector3d& point, int slot) const {
    if (surface == Surface::Sphere) {
      return (point - Eigen::Vector3d(0, 0, kDistance_mm + 30)).normalized();
    }
    if (surface == Surface::Step) {
      return -Eigen::Vector3d::UnitZ();
    }
    constexpr double step = 1e-3;
    const double dx =
        (*height(point.x() + step, point.y(), slot) - *height(point.x() - step, point.y(), slot)) /
        (2 * step);
    const double dy =
        (*height(point.x(), point.y() + step, slot) - *height(point.x(), point.y() - step, slot)) /
        (2 * step);
    return Eigen::Vector3d(dx, dy, -1).normalized();
  }

  /// Depth along z of a rectified lens at each of its pixels; 0 where nothing is.
  std::vector<double> depth_mm(const capture::Lens& lens, int slot) const {
    std::vector<double> out;
    const Eigen::Isometry3d rig_from_camera = lens.camera_from_rig.inverse();
    for (int y = 0; y < lens.height_px; ++y) {
      for (int x = 0; x < lens.width_px; ++x) {
        const Eigen::Vector3d direction((x - lens.cx_px) / lens.fx_px, (y - lens.cy_px) / lens.fy_px, 1);
        const auto point = meet(rig_from_camera.translation(), rig_from_camera.linear() * direction, slot);
        out.push_back(point ? (lens.camera_from_rig * *point).z() : 0);
      }
    }
    return out;
  }

  /// What a camera sees in a slot.
  Frame picture(std::size_t camera, int slot) const {
    const capture::Lens& lens = rig.cameras[camera].lens;
    const capture::Lens& projector = rig.projectors.front().lens;
    const std::vector<double> stripes = stripes_of(slot);
    const Eigen::Isometry3d rig_from_camera = lens.camera_from_rig.inverse();
    std::mt19937_64 random(seed * 7919ULL + static_cast<std::uint64_t>(slot) * 31 + camera);
    std::normal_distribution<double> normal_noise;
    const double exposure = camera == 1 ? right_gain : 1;
    auto pixels = std::make_shared<std::vector<std::uint8_t>>(
        static_cast<std::size_t>(lens.width_px) * static_cast<std::size_t>(lens.height_px) * 4,
        std::uint8_t{255});
    std::size_t at = 0;
    for (int y = 0; y < lens.height_px; ++y) {
      for (int x = 0; x < lens.width_px; ++x, at += 4) {
        double light = 0;
        for (int k = 0; k < samples * samples; ++k) {
          const int across = k % samples;
          const int down = k / samples;
          const Eigen::Vector2d pixel(x + (across + 0.5) / samples - 0.5, y + (down + 0.5) / samples - 0.5);
          const auto direction = lens.direction(pixel);
          const auto point =
              direction ? meet(rig_from_camera.translation(), rig_from_camera.linear() * *direction, slot)
                        : std::nullopt;
          if (point) {
            light += radiance(*point, slot, projector, stripes);
          }
        }
        light *= exposure / (samples * samples);
        light += noise * std::sqrt(std::max(light, 0.0) + 0.05) * normal_noise(random);
        light = std::clamp(light, 0.0, 1.0);
        const double coded = light <= 0.0031308 ? 12.92 * light : 1.055 * std::pow(light, 1 / 2.4) - 0.055;
        std::fill_n(pixels->begin() + static_cast<std::ptrdiff_t>(at), 3,
                    static_cast<std::uint8_t>(std::lround(255 * coded)));
      }
    }
    Frame frame;
    frame.sequence = static_cast<std::uint64_t>(slot);
    frame.width_px = lens.width_px;
    frame.height_px = lens.height_px;
    frame.stride_bytes = static_cast<std::size_t>(lens.width_px) * 4;
    frame.pixels = std::shared_ptr<const std::uint8_t[]>(pixels, pixels->data());
    return frame;
  }

 private:
  /// Grey of the projector's columns: random stripes, blurred as lenses do, all 0 in a blank slot; or
  /// fringes.
  std::vector<double> stripes_of(int slot) const {
    const int width = rig.projectors.front().lens.width_px;
    const auto stripe =
        static_cast<std::size_t>(std::lround(stripe_mm * rig.projectors.front().lens.fx_px / kDistance_mm));
    std::vector<double> sharp(static_cast<std::size_t>(width), 0.0);
    if (fringe_mm > 0) {
      const double period_px = fringe_mm * rig.projectors.front().lens.fx_px / kDistance_mm;
      for (std::size_t u = 0; u < sharp.size(); ++u) {
        const double turns = static_cast<double>(u) / period_px + shift_turns(slot);
        sharp[u] = has_pattern(slot) ? 0.5 + 0.5 * std::cos(2 * std::numbers::pi * turns) : 0.5;
      }
      return sharp;
    }
    if (!has_pattern(slot)) {
      return sharp;
    }
    std::mt19937_64 random(seed * 104729ULL + static_cast<std::uint64_t>(slot));
    std::uniform_real_distribution<double> uniform;
    double grey = 0;
    for (std::size_t u = 0; u < sharp.size(); ++u) {
      grey = u % stripe == 0 ? uniform(random) : grey;
      sharp[u] = grey;
    }
    std::vector<double> out(sharp.size());
    for (int u = 0; u < width; ++u) {
      double sum = 0;
      double weights = 0;
      for (int k = -4; k <= 4; ++k) {
        const double weight = std::exp(-0.5 * k * k / (1.2 * 1.2));
        sum += weight * sharp[static_cast<std::size_t>(std::clamp(u + k, 0, width - 1))];
        weights += weight;
      }
      out[static_cast<std::size_t>(u)] = sum / weights;
    }
    return out;
  }

  double radiance(const Eigen::Vector3d& point, int slot, const capture::Lens& projector,
                  const std::vector<double>& stripes) const {
    const double albedo = 0.62 + 0.05 * std::sin(point.x() / 7) * std::cos(point.y() / 9);
    const auto lit = projector.project(point);
    double light = 0;
    if (lit && lit->x() >= 0 && lit->x() < projector.width_px - 1) {
      const auto u = static_cast<std::size_t>(lit->x());
      const double f = lit->x() - static_cast<double>(u);
      const double facing =
          std::max(normal(point, slot).dot((projector.centre_mm() - point).normalized()), 0.0);
      light = facing * ((1 - f) * stripes[u] + f * stripes[u + 1]);
    }
    return albedo * (ambient + light);
  }
};

}  // namespace facet::test
