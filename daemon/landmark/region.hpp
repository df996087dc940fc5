#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "facet/frame.hpp"

namespace facet::landmark {

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
  /// From a net's points, in pixels of its input that shows the window, to image pixels; z in the same scale.
  ///
  /// net_px     [3][count]
  /// input_side of the net's input
  /// image_px   [3][count] out
  void image_from_net(const Eigen::Ref<const Eigen::Matrix3Xf>& net_px, int input_side,
                      Eigen::Matrix3Xf& image_px) const;
};

/// What a window shows beyond the border of the image.
enum class Border { Black, Replicate };

/// Samples windows of frames as planar RGB images of one size. Windows with more pixels than the output are
/// first averaged over whole boxes of pixels, so that nothing aliases; then sampling is bilinear. Works on
/// the sRGB values, as the nets were trained. One thread; allocates nothing after construction, except for a
/// wider frame than any before.
class RegionSampler {
 public:
  /// side: of the output in pixels
  explicit RegionSampler(int side);

  /// value = scale * sRGB byte + offset.
  ///
  /// frame    not empty
  /// region   finite, size_px > 0
  /// planar   [3][side][side] out, red first
  void sample(const Frame& frame, const Region& region, Border border, float scale, float offset,
              std::span<float> planar);

 private:
  /// An image of RGBA bytes whose pixel (0, 0) averages the box at (first_x, first_y) of a frame.
  struct Source {
    const std::uint8_t* pixels = nullptr;
    std::size_t stride_bytes = 0;
    int width = 0;
    int height = 0;
    float box = 1;  ///< frame pixels per pixel
    int first_x = 0;
    int first_y = 0;
  };

  Source average_boxes(const Frame& frame, const Region& region, int box);

  int side_;
  std::vector<std::uint8_t> averaged_;      ///< [rows][columns][4]
  std::vector<std::uint16_t> column_sums_;  ///< [columns of one row of boxes][4]
};

}  // namespace facet::landmark
