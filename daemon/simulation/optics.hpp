#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "capture/rig.hpp"
#include "facet/frame.hpp"
#include "simulation/lens_rays.hpp"
#include "simulation/webcam.hpp"

namespace facet::simulation {

/// A ray of a picture.
struct PictureRay {
  Eigen::Vector3f direction{0, 0, 1};  ///< unit, camera frame; NaN where the lens sees nothing
  float time = 0;                      ///< 0 to 1, of what moves while the picture is taken
};

/// How a camera looks. Both functions may be called from several threads.
struct Optics {
  int width_px = 0;
  int height_px = 0;
  /// The rays of a pixel, one for each offset from its centre; `rays` has their size.
  std::function<void(int x, int y, const std::vector<Eigen::Vector2f>& offsets_px,
                     std::vector<PictureRay>& rays)>
      look;
  /// Where a point of the camera frame is seen, px; nothing where the lens does not say.
  std::function<std::optional<Eigen::Vector2f>(const Eigen::Vector3f& point_mm)> project;
};

/// One moment through a pinhole.
Optics pinhole_optics(const CameraIntrinsics& camera);

/// A webcam's lens and shutter: each ray at its own place and time, time 0 the first row's first light and
/// 1 the last row's last.
/// lens, rays    borrowed
/// noise_seed    says which part of the exposure meets which part of a pixel
Optics webcam_optics(const capture::Lens& lens, const LensRays& rays, const Webcam& webcam,
                     std::uint64_t noise_seed);

}  // namespace facet::simulation
