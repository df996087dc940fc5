#pragma once

#include <vector>

#include "capture/rig.hpp"

namespace facet::capture {

/// Depth of one slot as a pair of cameras saw it.
struct DepthMap {
  int width_px = 0;
  int height_px = 0;
  /// The camera of the map: no distortion, camera_from_rig in the rig's frame. Pixel (x, y) at depth z is the
  /// point z ((x - cx) / fx, (y - cy) / fy, 1) of its frame.
  Lens lens;
  std::vector<float> depth_mm;    ///< [height_px][width_px] along z of lens; 0 in a hole
  std::vector<float> sigma_mm;    ///< [height_px][width_px] standard deviation of the depth; 0 in a hole
  std::vector<float> confidence;  ///< [height_px][width_px] 0 in a hole, else up to 1
};

}  // namespace facet::capture
