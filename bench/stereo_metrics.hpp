#pragma once

#include <cstddef>
#include <vector>

#include "render/renderer.hpp"
#include "stereo_footage.hpp"

namespace facet::bench {

/// Figures of depth maps against truth, gathered over slots.
class DepthFigures {
 public:
  /// depth_mm  [height][width], 0 in holes
  void add(const StereoFootage& footage, std::size_t slot, const std::vector<float>& depth_mm);

  bool empty() const { return errors_mm_.empty(); }
  /// Of |depth - truth| over the surface that both cameras see, where there is a depth.
  double percentile_mm(double fraction) const;
  /// Part of the surface seen by both cameras that has a depth.
  double fill() const;
  /// Depths where the left camera sees no thing at all.
  std::size_t invented() const { return invented_; }
  /// Root mean square of the error band-passed along the scan line (waves of 4 to 16 px): what shows as
  /// ridges.
  double ridges_mm() const;

 private:
  mutable std::vector<float> errors_mm_;
  std::size_t seen_ = 0;
  std::size_t invented_ = 0;
  double band_square_ = 0;
  std::size_t band_count_ = 0;
};

/// Shaded relief of a depth map, lit from the upper left; holes are blue.
render::Picture relief(const StereoFootage& footage, const std::vector<float>& depth_mm);

/// |depth - truth| where it is judged, 0 to 1 mm as heat; white: a hole there, red: an invented depth.
render::Picture error_picture(const StereoFootage& footage, std::size_t slot,
                              const std::vector<float>& depth_mm);

}  // namespace facet::bench
