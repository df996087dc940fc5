#pragma once

#include <span>
#include <vector>

#include "capture/rig.hpp"

namespace facet::capture {

/// How far a depth is to be trusted: 1 where it is exact, 0.5 at a standard deviation of half_mm.
inline float depth_confidence(float sigma_mm, float half_mm = 0.1F) {
  const float relative = sigma_mm / half_mm;
  return 1 / (1 + relative * relative);
}

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

/// Counts confidence in the maps' own noise: 0.5 at the median of their standard deviations. What is fitted
/// to them is then as stiff in a booth that is noisier, and where the noise is even.
void weigh_by_own_noise(std::span<DepthMap> maps);

}  // namespace facet::capture
