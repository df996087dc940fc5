#include "support/frames.hpp"

#include <cmath>
#include <cstring>
#include <opencv2/imgproc.hpp>

#include "files/image_file.hpp"
#include "support/paths.hpp"

namespace facet::test {

Frame make_frame(int width, int height, const std::function<cv::Vec3b(int, int)>& colour,
                 std::size_t padding_bytes) {
  Frame frame;
  frame.width_px = width;
  frame.height_px = height;
  frame.stride_bytes = 4 * static_cast<std::size_t>(width) + padding_bytes;
  const std::shared_ptr<std::uint8_t[]> pixels(
      new std::uint8_t[frame.stride_bytes * static_cast<std::size_t>(height)]);
  for (int y = 0; y < height; ++y) {
    std::uint8_t* row = pixels.get() + static_cast<std::size_t>(y) * frame.stride_bytes;
    for (std::size_t i = 0; i < frame.stride_bytes; ++i) {
      row[i] = static_cast<std::uint8_t>(37 * i + 101);
    }
    for (int x = 0; x < width; ++x) {
      const cv::Vec3b rgb = colour(x, y);
      std::uint8_t* pixel = row + 4 * static_cast<std::size_t>(x);
      pixel[0] = rgb[0];
      pixel[1] = rgb[1];
      pixel[2] = rgb[2];
      pixel[3] = 255;
    }
  }
  frame.pixels = pixels;
  return frame;
}

Frame frame_of(const cv::Mat& bgr) {
  return make_frame(bgr.cols, bgr.rows, [&](int x, int y) {
    const auto& pixel = bgr.at<cv::Vec3b>(y, x);
    return cv::Vec3b(pixel[2], pixel[1], pixel[0]);
  });
}

cv::Mat read_photo(const std::string& name) {
  const std::filesystem::path file = assets() / "photos" / name;
  if (!std::filesystem::exists(file)) {
    return {};
  }
  files::RgbImage<std::uint8_t> image = files::read_image<std::uint8_t>(file);
  cv::Mat bgr;
  cv::cvtColor(cv::Mat(image.height_px, image.width_px, CV_8UC3, image.values.data()), bgr,
               cv::COLOR_RGB2BGR);
  return bgr;
}

cv::Mat warped(const cv::Mat& bgr, const cv::Matx23d& canvas_from_picture, cv::Size canvas) {
  cv::Mat result;
  const double scale = std::hypot(canvas_from_picture(0, 0), canvas_from_picture(1, 0));
  cv::Mat source = bgr;
  if (scale < 1) {
    // What a camera does: light of a whole pixel is gathered before it is sampled.
    cv::GaussianBlur(bgr, source, {}, 0.5 / scale);
  }
  cv::warpAffine(source, result, canvas_from_picture, canvas, cv::INTER_CUBIC, cv::BORDER_CONSTANT,
                 cv::Scalar(90, 90, 90));
  return result;
}

cv::Matx23d similarity(cv::Point2d about, cv::Point2d to, double scale, double rotation_rad) {
  const double c = scale * std::cos(rotation_rad);
  const double s = scale * std::sin(rotation_rad);
  return {c, -s, to.x - c * about.x + s * about.y, s, c, to.y - s * about.x - c * about.y};
}

std::filesystem::path landmark_nets() {
  return assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
}

}  // namespace facet::test
