#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "facet/frame.hpp"

namespace facet::fit {

/// A part of a picture.
struct PixelBox {
  int left = 0;
  int top = 0;
  int width = 0;
  int height = 0;
};

/// Where everything in a picture went, and how far that is to be trusted.
struct Flow {
  int width_px = 0;
  int height_px = 0;
  std::vector<Eigen::Vector2f> flow_px;  ///< [height_px][width_px] from the earlier picture's pixels
  /// [height_px][width_px] 1 where going there and back ends where it began, falling to 0 at a pixel's
  /// distance.
  std::vector<float> confidence;
};

/// Dense optical flow between consecutive pictures of one camera, there and back (DIS [KTDG16];
/// docs/template-fit.md says why). One thread at a time.
class OpticalFlow {
 public:
  OpticalFlow();
  ~OpticalFlow();

  /// Within a box, which is enlarged to 64 px a side where the pictures have them; beside it nothing is known
  /// (confidence 0). Throws Error(Usage) where the pictures are empty or of different sizes.
  void find(const Frame& earlier, const Frame& later, const PixelBox& box, Flow& out);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::fit
