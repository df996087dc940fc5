#pragma once

#include <Eigen/Core>
#include <vector>

#include "capture/rig.hpp"

namespace facet::simulation {

/// Where a lens with distortion looks, ready for rays. Any thread.
class LensRays {
 public:
  /// Undoes the distortion at every pixel; runs on up to two threads.
  explicit LensRays(const capture::Lens& lens);

  /// Direction with z = 1, camera frame, at a pixel and an offset of less than one; NaN where the lens sees
  /// nothing. Distortion bends so little within a pixel that directions between the centres are interpolated.
  Eigen::Vector3f direction(int x, int y, const Eigen::Vector2f& offset_px) const;

 private:
  int columns_ = 0;
  /// x and y of the directions (z = 1, camera frame) of all pixels' centres and one more on every side,
  /// [height_px + 2][width_px + 2]; NaN where the lens sees nothing.
  std::vector<Eigen::Vector2f> directions_;
};

}  // namespace facet::simulation
