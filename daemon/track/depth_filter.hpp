#pragma once

namespace facet::track {

/// Low-pass filter of a head's distance from the camera whose cut-off rises with its speed (the One Euro
/// filter [CRV12]). Landmarks tell the distance by the size of the face alone: a hundredth of a
/// pixel of noise moves a head at 600 mm by some hundredths of a millimetre, which is nearly all that a still
/// face trembles. One thread.
class DepthFilter {
 public:
  /// Forgets all; the next distance passes unchanged.
  void reset() { started_ = false; }

  /// The filtered distance, mm.
  /// seconds  > 0, since the last frame
  double apply(double depth_mm, double seconds);

 private:
  bool started_ = false;
  double measured_mm_ = 0;
  double filtered_mm_ = 0;
  double velocity_mm_s_ = 0;
};

}  // namespace facet::track
