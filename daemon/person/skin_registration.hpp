#pragma once

// Private to this room: brings what keyframes show of a chart onto each other.

#include <Eigen/Core>
#include <array>
#include <opencv2/core.hpp>

#include "person/skin_texels.hpp"

namespace facet::person {

/// The flow from the skin's albedo to what one picture shows of it without its light, in texels: both are
/// taken as deviations from what is around, and only where the flow comes back to where it began is it
/// believed.
class SkinRegistration {
 public:
  /// albedo  [count] brightness; known [count] 0: nothing is known of the texel. texels must outlive it.
  SkinRegistration(const SkinTexels& texels, const Eigen::ArrayXf& albedo, const Eigen::ArrayXf& known);

  /// shown    [count] brightness over shading
  /// weight   [count] 1: the picture shows the texel; 0
  /// returns  x and y [height][width] of where each texel lies in the picture's chart, less its own place
  std::array<cv::Mat, 2> flow(const Eigen::ArrayXf& shown, const Eigen::ArrayXf& weight) const;

 private:
  cv::Mat deviations(const Eigen::ArrayXf& values, const Eigen::ArrayXf& weight, cv::Mat& shows) const;

  const SkinTexels& texels_;
  cv::Mat reference_;  ///< coarser than the chart
};

/// How far logarithms of brightness stand out of what is around them, over how far it usually does there.
/// shows  [height][width] 1: known; 0. sigma  texels
cv::Mat deviations(const cv::Mat& logs, const cv::Mat& shows, double sigma);

/// image [height][width] at each texel's place moved by a flow, linear in between; beyond it its edge.
cv::Mat moved(const cv::Mat& image, const std::array<cv::Mat, 2>& flow);

}  // namespace facet::person
