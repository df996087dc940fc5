#include "simulation/sensor.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "render/renderer.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

constexpr float kSide = 0.1F;  // the optics' blur: part of each neighbour, along rows and columns

/// sRGB values of evenly spaced linear ones: the transfer function is too slow for every pixel.
std::uint8_t encode(float linear) {
  constexpr int kSteps = 1 << 15;
  static const std::vector<std::uint8_t> table = [] {
    std::vector<std::uint8_t> made(kSteps + 1);
    for (int k = 0; k <= kSteps; ++k) {
      made[static_cast<std::size_t>(k)] = render::linear_to_srgb8(static_cast<float>(k) / kSteps);
    }
    return made;
  }();
  return table[static_cast<std::size_t>(std::lround(std::clamp(linear, 0.0F, 1.0F) * kSteps))];
}

/// About a standard normal: the sum of four uniform values.
float rough_normal(std::uint64_t hash) {
  float sum = 0;
  for (int part = 0; part < 4; ++part) {
    sum += static_cast<float>((hash >> (16 * part)) & 0xFFFF) / 65535.0F;
  }
  return (sum - 2) * std::numbers::sqrt3_v<float>;
}

}  // namespace

std::vector<std::uint8_t> develop(const Eigen::Ref<const Eigen::MatrixXf>& light, int width_px, int height_px,
                                  const Sensor& sensor, std::uint64_t noise_seed) {
  const Eigen::Index channels = light.rows();
  std::vector<std::uint8_t> bytes(static_cast<std::size_t>(light.size()));
  render::for_each_row(height_px, [&](int y) {
    const auto row = [&](int at) {
      return static_cast<Eigen::Index>(std::clamp(at, 0, height_px - 1)) * width_px;
    };
    const Eigen::Index above = row(y - 1);
    const Eigen::Index here = row(y);
    const Eigen::Index below = row(y + 1);
    for (int x = 0; x < width_px; ++x) {
      const Eigen::Index left = std::max(x - 1, 0);
      const Eigen::Index right = std::min(x + 1, width_px - 1);
      const std::size_t pixel = static_cast<std::size_t>(here + x);
      for (Eigen::Index c = 0; c < channels; ++c) {
        const float edges =
            light(c, here + left) + light(c, here + right) + light(c, above + x) + light(c, below + x);
        const float corners = light(c, above + left) + light(c, above + right) + light(c, below + left) +
                              light(c, below + right);
        constexpr float kCentre = 1 - 2 * kSide;
        const float value = std::max(
            0.0F, kCentre * kCentre * light(c, here + x) + kCentre * kSide * edges + kSide * kSide * corners);
        const std::size_t at = pixel * static_cast<std::size_t>(channels) + static_cast<std::size_t>(c);
        float noise = 0;
        if (sensor.noise) {
          const float sigma =
              std::sqrt(value * sensor.full_well_e + sensor.read_noise_e * sensor.read_noise_e) /
              sensor.full_well_e;
          noise = sigma * rough_normal(mix(noise_seed + at));
        }
        bytes[at] = encode(value + noise);
      }
    }
  });
  return bytes;
}

}  // namespace facet::simulation
