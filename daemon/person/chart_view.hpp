#pragma once

// Private to this room: what a picture shows of a face's texture chart.

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "mesh/mesh.hpp"
#include "person/keyframes.hpp"
#include "person/shape_solver.hpp"
#include "person/texture_chart.hpp"

namespace facet::person {

/// Where each of a chart's texels lies in a picture of the head. All [height][width] float.
struct ChartView {
  cv::Mat x_px, y_px;   ///< in the keyframe's picture, -10 where no triangle holds the texel
  cv::Mat weight;       ///< 0 to 1: 0 where the picture does not show it, it is turned away or saturated
  cv::Mat position_mm;  ///< [3] camera frame
  cv::Mat normal;       ///< [3] camera frame, unit
};

/// Reads a picture of a surface.
///
/// camera      of the whole picture
/// surface_mm  [3][vertex_count] camera frame
ChartView chart_view(const TextureChart& chart, const mesh::Triangles& triangles, const HeadPicture& picture,
                     const CameraIntrinsics& camera, const mesh::Vertices& surface_mm);

/// The same of the head as the solver holds it to be. centre_px  of the whole picture
ChartView chart_view(const TextureChart& chart, const mesh::Triangles& triangles, const HeadPicture& picture,
                     const ShapeSolver& solver, const HeadState& head, const Eigen::Vector2d& centre_px);

/// [height][width][3] bytes; the picture's own memory.
cv::Mat rgb_of(const HeadPicture& picture);

/// image at (x, y), linear in between, 0 outside.
cv::Mat sample(const cv::Mat& image, const cv::Mat& x, const cv::Mat& y);

/// By a Gaussian; sigma in texels.
cv::Mat blurred(const cv::Mat& image, double sigma);

/// Bytes for a flow of what is told in deviations: 42 each from 128 on, three to both sides.
cv::Mat as_bytes(const cv::Mat& deviations);

/// 0 below low, 1 above high, smooth in between.
float smoothstep(float x, float low, float high);

}  // namespace facet::person
