#include "landmark/landmark_net.hpp"

#include <algorithm>
#include <cmath>

#include "facet/error.hpp"

namespace facet::landmark {
namespace {

constexpr int input_side = FacePicture::side;

}  // namespace

LandmarkNet::LandmarkNet(std::span<const std::uint8_t> tflite, const std::string& name)
    : network_(parse_tflite(tflite, name), name) {
  if (network_.input_rows() != input_side || network_.input_columns() != input_side ||
      network_.output_count() != 2 || network_.output(0).size() != std::size_t{3} * landmark_count ||
      network_.output(1).size() != 1) {
    throw Error(ErrorKind::UnreadableInput, name + ": not the 468-point face mesh net");
  }
}

float LandmarkNet::find(const FacePicture& picture, Eigen::Matrix3Xf& points_px) {
  std::ranges::copy(picture.values(), network_.input().begin());
  network_.forward();
  const Eigen::Map<const Eigen::Matrix3Xf> raw(network_.output(0).data(), 3, landmark_count);
  picture.window().image_from_net(raw, input_side, points_px);
  return 1 / (1 + std::exp(-network_.output(1)[0]));
}

}  // namespace facet::landmark
