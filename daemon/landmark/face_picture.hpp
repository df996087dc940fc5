#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "facet/frame.hpp"
#include "landmark/region.hpp"

namespace facet::landmark {

/// What both landmark nets look at: a window of a frame as 192 x 192 pixels. They were trained on values from
/// 0 to 1 and the border repeated.
class FacePicture {
 public:
  static constexpr int side = 192;

  /// Allocates nothing after the first calls.
  void sample(const Frame& frame, const Region& window) {
    window_ = window;
    sampler_.sample(frame, window, Border::Replicate, 1 / 255.0F, 0.0F, values_);
  }

  const Region& window() const { return window_; }           ///< the last that was sampled
  std::span<const float> values() const { return values_; }  ///< [3][side][side]: planar, red first

 private:
  RegionSampler sampler_{side};
  Region window_;
  std::vector<float> values_ = std::vector<float>(std::size_t{3} * side * side);
};

}  // namespace facet::landmark
