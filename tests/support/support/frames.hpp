#pragma once

#include <filesystem>
#include <functional>
#include <opencv2/core.hpp>

#include "facet/frame.hpp"

namespace facet::test {

/// A frame whose pixel (x, y) has the colour that the function gives, 0 to 255. Rows are `padding_bytes`
/// longer than their pixels, filled with noise that nobody may read.
Frame make_frame(int width, int height, const std::function<cv::Vec3b(int, int)>& colour,
                 std::size_t padding_bytes = 0);

/// A frame of an OpenCV picture (8-bit BGR), copied.
Frame frame_of(const cv::Mat& bgr);

/// A photograph of the test set, 8-bit BGR; empty where it is missing.
cv::Mat read_photo(const std::string& name);

/// The picture seen through a similarity, on a canvas of the given size.
///
/// canvas_from_picture  2 x 3
cv::Mat warped(const cv::Mat& bgr, const cv::Matx23d& canvas_from_picture, cv::Size canvas);

/// The similarity that scales and turns a picture about `about` and carries that point to `to`.
cv::Matx23d similarity(cv::Point2d about, cv::Point2d to, double scale, double rotation_rad);

/// The MediaPipe assets, which may be missing.
std::filesystem::path landmark_nets();

}  // namespace facet::test
