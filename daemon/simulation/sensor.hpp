#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace facet::simulation {

/// What stands between light and bytes.
struct Sensor {
  float full_well_e = 6000;  ///< electrons of a white pixel
  float read_noise_e = 5;
  bool noise = true;
};

/// Optics, sensor and encoding: a blur of about half a pixel (sigma), shot and read noise, sRGB. Runs on up
/// to two threads; the same for the same noise_seed. light     [1 or 3][height_px * width_px] linear, 1 is
/// white returns   [height_px * width_px][rows of light]
std::vector<std::uint8_t> develop(const Eigen::Ref<const Eigen::MatrixXf>& light, int width_px, int height_px,
                                  const Sensor& sensor, std::uint64_t noise_seed);

}  // namespace facet::simulation
