#pragma once

#include <memory>

#include "facet/camera.hpp"

namespace facet::camera {

/// How pictures are turned before anybody sees them, for a camera that hangs on its side or gives a mirror's
/// picture.
struct PictureTurn {
  int clockwise_deg = 0;  ///< 0, 90, 180 or 270: the picture is turned by so much
  bool mirror = false;    ///< then left and right change places

  bool plain() const { return clockwise_deg == 0 && !mirror; }
};

/// The intrinsics of the turned picture.
CameraIntrinsics turned(const CameraIntrinsics& given, const PictureTurn& turn);

/// The camera with its pictures turned; calls, states and numbers are those of `camera`. Throws Error(Usage)
/// where clockwise_deg is none of the four.
std::unique_ptr<Camera> turn_pictures(std::unique_ptr<Camera> camera, const PictureTurn& turn);

}  // namespace facet::camera
