#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace facet::stereo {

/// Finds pieces of a depth map that are too small to be a surface. Keeps its memory from call to call. One
/// thread at a time.
class Islands {
 public:
  Islands(int width_px, int height_px);

  /// Sets the depth of connected pieces of less than least_px pixels to 0. Neighbours are connected where
  /// both have a depth and their values differ by no more than break_at.
  /// values    [height][width] disparity or depth
  /// depth_mm  [height][width] in/out, 0 in holes
  void drop(std::span<const float> values, float break_at, int least_px, std::span<float> depth_mm);

 private:
  int width_;
  std::vector<std::uint8_t> seen_;         ///< [height][width]
  std::vector<std::size_t> open_, piece_;  ///< of the flood fill
};

}  // namespace facet::stereo
