#include "landmark/landmark_net.hpp"

#include <cmath>

#include "facet/error.hpp"

namespace facet::landmark {
namespace {

constexpr int input_side = 192;

}  // namespace

LandmarkNet::LandmarkNet(std::span<const std::uint8_t> tflite, const std::string& name)
    : network_(parse_tflite(tflite, name), name), sampler_(input_side) {
  if (network_.input_rows() != input_side || network_.input_columns() != input_side ||
      network_.output_count() != 2 || network_.output(0).size() != std::size_t{3} * landmark_count ||
      network_.output(1).size() != 1) {
    throw Error(ErrorKind::UnreadableInput, name + ": not the 468-point face mesh net");
  }
}

float LandmarkNet::find(const Frame& frame, const Region& window, Eigen::Matrix3Xf& points_px) {
  // The net was trained on values from 0 to 1 and the border repeated.
  sampler_.sample(frame, window, Border::Replicate, 1 / 255.0F, 0.0F, network_.input());
  network_.forward();
  const Eigen::Map<const Eigen::Matrix3Xf> raw(network_.output(0).data(), 3, landmark_count);
  window.image_from_net(raw, input_side, points_px);
  return 1 / (1 + std::exp(-network_.output(1)[0]));
}

}  // namespace facet::landmark
