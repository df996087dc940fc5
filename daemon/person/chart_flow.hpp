#pragma once

// Private to this room: how skin lies in a picture's chart against where it is known to lie.

#include <array>
#include <opencv2/core.hpp>

namespace facet::person {

/// All [height][width] float.
struct ChartFlow {
  std::array<cv::Mat, 2>
      step;           ///< x, y, texels: where a texel's skin lies in the picture's chart, less its own place
  cv::Mat agreement;  ///< 0 to 1: how alike the two are there once the step is made
};

/// The most likely flow u between two charts of deviations() (docs/person.md, "Following the skin"):
///   min over u of sum_t w_t rho((shown(t + u_t) - reference(t)) / s) + |u|^2 / usual^2 and its smoothness,
/// by Gauss-Newton, with s the residuals' own scale: charts that have little to do with each other say
/// little.
///
/// weight    0 to 1: the reference and the picture show the texel
/// usual_mm  how far skin usually is from its place; alike over some mm
ChartFlow flow_on_chart(const cv::Mat& reference, const cv::Mat& shown, const cv::Mat& weight,
                        double texel_mm, double usual_mm);

}  // namespace facet::person
