#include <algorithm>
#include <cmath>

#include "maths/harmonics.hpp"
#include "maths/srgb.hpp"
#include "render/renderer.hpp"

namespace facet::render {
namespace {

std::uint8_t to_byte(float value) {
  return static_cast<std::uint8_t>(std::lround(255.0F * std::clamp(value, 0.0F, 1.0F)));
}

}  // namespace

float irradiance(const std::array<float, 9>& lighting, const Eigen::Vector3f& normal_camera) {
  const auto basis = maths::harmonics(normal_camera.x(), -normal_camera.y(), -normal_camera.z());
  float sum = 0;
  for (std::size_t k = 0; k < basis.size(); ++k) {
    sum += lighting[k] * basis[k];
  }
  return sum;
}

std::uint8_t linear_to_srgb8(float linear) {
  return to_byte(maths::encode_srgb(std::clamp(linear, 0.0F, 1.0F)));
}

float srgb8_to_linear(std::uint8_t srgb) {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> made{};
    for (std::size_t k = 0; k < made.size(); ++k) {
      made[k] = maths::decode_srgb(static_cast<float>(k) / 255.0F);
    }
    return made;
  }();
  return table[srgb];
}

std::array<std::uint8_t, 3> heat_colour(float value) {
  if (std::isnan(value)) {
    return {128, 128, 128};
  }
  static constexpr std::array<std::array<float, 3>, 8> kStops{{{14, 8, 76},
                                                               {56, 14, 140},
                                                               {112, 24, 160},
                                                               {164, 44, 142},
                                                               {208, 78, 104},
                                                               {240, 122, 66},
                                                               {252, 178, 46},
                                                               {246, 240, 90}}};
  const float at = std::clamp(value, 0.0F, 1.0F) * static_cast<float>(kStops.size() - 1);
  const auto low = std::min(static_cast<std::size_t>(at), kStops.size() - 2);
  const float part = at - static_cast<float>(low);
  std::array<std::uint8_t, 3> colour{};
  for (std::size_t k = 0; k < 3; ++k) {
    colour[k] = to_byte(((1 - part) * kStops[low][k] + part * kStops[low + 1][k]) / 255.0F);
  }
  return colour;
}

std::array<std::uint8_t, 3> normal_colour(const Eigen::Vector3f& normal_camera) {
  return {to_byte(0.5F + 0.5F * normal_camera.x()), to_byte(0.5F - 0.5F * normal_camera.y()),
          to_byte(0.5F - 0.5F * normal_camera.z())};
}

}  // namespace facet::render
