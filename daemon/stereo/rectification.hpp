#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "capture/rig.hpp"

namespace facet::stereo {

/// Depths of interest along the left camera's rectified z axis.
struct DepthRange {
  float nearest_mm = 0;
  float farthest_mm = 0;
};

/// Two pinhole cameras without distortion that stand where a pair's cameras stand and are turned alike, x
/// along the baseline: a point is seen in the same row of both. Left pixel (x, y) and right pixel (x - d, y)
/// see the same point at depth = focal_px * baseline_mm / (d + offset_px), along z of both.
///
/// Their principal points are chosen such that the middle of the depth range is in the middle of both
/// pictures, where d = 0.
class Rectification {
 public:
  /// width_px, height_px  of the rectified pictures; the focal length is the mean of the lenses', times
  ///                      width_px / the left lens's width
  /// Throws Error(Usage) where the pair's cameras are not in the rig, are one, stand in the wrong order
  /// (right to the left of left), look apart by more than 60 degrees or across their baseline, or the depths
  /// are not 0 < nearest < farthest.
  Rectification(const capture::Rig& rig, const capture::StereoPair& pair, const DepthRange& depths,
                int width_px, int height_px);

  /// The rectified cameras, in the rig's frame.
  const capture::Lens& left() const { return left_; }
  const capture::Lens& right() const { return right_; }
  double baseline_mm() const { return baseline_mm_; }
  double offset_px() const { return offset_px_; }

  /// The disparities of the depth range, widened to whole pixels.
  int least_disparity_px() const { return least_disparity_px_; }
  int most_disparity_px() const { return most_disparity_px_; }

  double depth_mm(double disparity_px) const {
    return left_.fx_px * baseline_mm_ / (disparity_px + offset_px_);
  }
  double disparity_px(double depth) const { return left_.fx_px * baseline_mm_ / depth - offset_px_; }

  /// What one px of disparity is at a depth, mm.
  double depth_per_px_mm(double depth) const { return depth * depth / (left_.fx_px * baseline_mm_); }

  /// Where the rectified pixels of one camera lie in its own picture: [height_px][width_px], px; (-1, -1)
  /// outside.
  std::vector<Eigen::Vector2f> left_sources() const;
  std::vector<Eigen::Vector2f> right_sources() const;

  /// The pixel of the left camera's own picture that a rectified left pixel shows; nothing where the lens
  /// sees nothing there.
  std::optional<Eigen::Vector2d> left_picture_px(const Eigen::Vector2d& rectified_px) const;

  /// The point at a depth behind a rectified left pixel, in the rig's frame.
  Eigen::Vector3d point_mm(const Eigen::Vector2d& rectified_px, double depth) const;

 private:
  std::vector<Eigen::Vector2f> sources(const capture::Lens& rectified, const capture::Lens& lens) const;

  capture::Lens left_camera_;
  capture::Lens right_camera_;
  capture::Lens left_;
  capture::Lens right_;
  double baseline_mm_ = 0;
  double offset_px_ = 0;
  int least_disparity_px_ = 0;
  int most_disparity_px_ = 0;
};

}  // namespace facet::stereo
