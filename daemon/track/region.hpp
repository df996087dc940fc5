#pragma once

#include <Eigen/Core>
#include <cmath>
#include <span>

#include "facet/frame.hpp"

namespace facet::track {

/// A square window on the image, turned about its centre. May reach beyond the image.
struct Region {
  Eigen::Vector2f centre_px = Eigen::Vector2f::Zero();
  float size_px = 0;       ///< side length
  float rotation_rad = 0;  ///< from the image's x axis to the window's, towards the image's y axis

  Eigen::Vector2f right() const { return {std::cos(rotation_rad), std::sin(rotation_rad)}; }
  Eigen::Vector2f down() const { return {-std::sin(rotation_rad), std::cos(rotation_rad)}; }

  /// From window coordinates (0,0 to 1,1) to image pixels.
  Eigen::Vector2f image_from_window(const Eigen::Vector2f& window) const {
    return centre_px + size_px * ((window.x() - 0.5F) * right() + (window.y() - 0.5F) * down());
  }
};

/// What a window shows beyond the border of the image.
enum class Border { Black, Replicate };

/// Samples a window of the frame as a planar RGB image: value = scale * sRGB byte + offset.
/// A window larger than the output is averaged over up to 4 x 4 samples a pixel; otherwise sampling is
/// bilinear. Works on the sRGB values, as the nets were trained. Reads only the pixels it needs; allocates
/// nothing.
///
/// frame    not empty
/// planar   [3][side][side] out
void sample_region(const Frame& frame, const Region& region, Border border, int side, float scale,
                   float offset, std::span<float> planar);

}  // namespace facet::track
