#include <fmt/format.h>

#include <algorithm>
#include <opencv2/imgproc.hpp>
#include <span>
#include <utility>

#include "facet/error.hpp"
#include "files/image_file.hpp"
#include "files/output_file.hpp"
#include "render/renderer.hpp"

namespace facet::render {
namespace {

std::size_t byte_count(int width_px, int height_px) {
  return 3 * static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px);
}

std::size_t offset_of(const Picture& picture, int x_px, int y_px) {
  return 3 * (static_cast<std::size_t>(y_px) * static_cast<std::size_t>(picture.width_px) +
              static_cast<std::size_t>(x_px));
}

/// OpenCV's view of a picture's memory. OpenCV does not write to it where the picture is const.
cv::Mat view_of(const Picture& picture) {
  return {picture.height_px, picture.width_px, CV_8UC3, const_cast<std::uint8_t*>(picture.rgb.data())};
}

}  // namespace

Picture plain_picture(int width_px, int height_px, std::array<std::uint8_t, 3> rgb) {
  Picture picture{width_px, height_px, std::vector<std::uint8_t>(byte_count(width_px, height_px))};
  for (std::size_t k = 0; k < picture.rgb.size(); ++k) {
    picture.rgb[k] = rgb[k % 3];
  }
  return picture;
}

Picture to_picture(const Frame& frame) {
  Picture picture{frame.width_px, frame.height_px,
                  std::vector<std::uint8_t>(byte_count(frame.width_px, frame.height_px))};
  for (int y = 0; y < frame.height_px; ++y) {
    const std::uint8_t* from = frame.row(y);
    std::uint8_t* to = picture.rgb.data() + offset_of(picture, 0, y);
    for (int x = 0; x < frame.width_px; ++x, from += 4, to += 3) {
      std::copy_n(from, 3, to);
    }
  }
  return picture;
}

Frame to_frame(const Picture& picture) {
  Frame frame;
  frame.width_px = picture.width_px;
  frame.height_px = picture.height_px;
  frame.stride_bytes = 4 * static_cast<std::size_t>(picture.width_px);
  const std::size_t pixel_count = picture.rgb.size() / 3;
  std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[4 * pixel_count]);
  for (std::size_t k = 0; k < pixel_count; ++k) {
    std::uint8_t* pixel = pixels.get() + 4 * k;
    std::copy_n(&picture.rgb[3 * k], 3, pixel);
    pixel[3] = 255;
  }
  frame.pixels = std::move(pixels);
  return frame;
}

std::vector<std::uint8_t> encode_png(const Picture& picture) {
  return files::encode_png(picture.width_px, picture.height_px, picture.rgb);
}

void write_png(const Picture& picture, const std::filesystem::path& file) {
  const std::vector<std::uint8_t> bytes = encode_png(picture);
  files::OutputFile output(file);
  output.write(std::as_bytes(std::span(bytes)));
  output.commit();
}

Picture read_image(const std::filesystem::path& file) {
  files::RgbImage<std::uint8_t> image = files::read_image<std::uint8_t>(file);
  return {image.width_px, image.height_px, std::move(image.values)};
}

GreyPicture read_grey(const std::filesystem::path& file) {
  const files::RgbImage<std::uint16_t> image = files::read_image<std::uint16_t>(file);
  GreyPicture picture{image.width_px, image.height_px, std::vector<float>(image.values.size() / 3)};
  for (std::size_t k = 0; k < picture.values.size(); ++k) {
    const std::uint16_t* rgb = &image.values[3 * k];
    picture.values[k] = static_cast<float>(rgb[0] + 2 * rgb[1] + rgb[2]) / (4.0F * 65535.0F);
  }
  return picture;
}

void paste(Picture& onto, const Picture& from, int x_px, int y_px) {
  const int first_x = std::max(0, -x_px);
  const int end_x = std::min(from.width_px, onto.width_px - x_px);
  if (end_x <= first_x) {
    return;
  }
  for (int y = std::max(0, -y_px); y < std::min(from.height_px, onto.height_px - y_px); ++y) {
    std::copy_n(&from.rgb[offset_of(from, first_x, y)], 3 * (end_x - first_x),
                &onto.rgb[offset_of(onto, x_px + first_x, y_px + y)]);
  }
}

Picture crop(const Picture& picture, int x_px, int y_px, int width_px, int height_px,
             std::array<std::uint8_t, 3> outside) {
  Picture part = plain_picture(width_px, height_px, outside);
  paste(part, picture, -x_px, -y_px);
  return part;
}

Picture resize(const Picture& picture, int width_px, int height_px) {
  if (picture.rgb.empty() || width_px < 1 || height_px < 1) {
    throw Error(ErrorKind::Internal, fmt::format("a picture of {}x{} px cannot be resized to {}x{} px",
                                                 picture.width_px, picture.height_px, width_px, height_px));
  }
  Picture resized{width_px, height_px, std::vector<std::uint8_t>(byte_count(width_px, height_px))};
  cv::Mat onto = view_of(resized);
  const bool shrinks = width_px < picture.width_px && height_px < picture.height_px;
  cv::resize(view_of(picture), onto, onto.size(), 0, 0, shrinks ? cv::INTER_AREA : cv::INTER_CUBIC);
  return resized;
}

}  // namespace facet::render
