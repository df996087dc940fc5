#include "track/region.hpp"

#include <algorithm>
#include <array>
#include <cstdint>

namespace facet::track {
namespace {

constexpr int max_samples_per_axis = 4;  ///< more reads cost more than the net gains from them

using Rgb = std::array<float, 4>;

/// The pixel at a clamped position.
const std::uint8_t* clamped_pixel(const Frame& frame, int x, int y) {
  return frame.row(std::clamp(y, 0, frame.height_px - 1)) + 4 * std::clamp(x, 0, frame.width_px - 1);
}

void add_bilinear(const Frame& frame, float x, float y, Rgb& sum) {
  const float floor_x = std::floor(x);
  const float floor_y = std::floor(y);
  const float right = x - floor_x;
  const float below = y - floor_y;
  const int x0 = static_cast<int>(floor_x);
  const int y0 = static_cast<int>(floor_y);
  const std::uint8_t* p00 = clamped_pixel(frame, x0, y0);
  const std::uint8_t* p01 = clamped_pixel(frame, x0 + 1, y0);
  const std::uint8_t* p10 = clamped_pixel(frame, x0, y0 + 1);
  const std::uint8_t* p11 = clamped_pixel(frame, x0 + 1, y0 + 1);
  const float w00 = (1 - right) * (1 - below);
  const float w01 = right * (1 - below);
  const float w10 = (1 - right) * below;
  const float w11 = right * below;
  for (std::size_t c = 0; c < 4; ++c) {
    sum[c] += w00 * p00[c] + w01 * p01[c] + w10 * p10[c] + w11 * p11[c];
  }
}

}  // namespace

void sample_region(const Frame& frame, const Region& region, Border border, int side, float scale,
                   float offset, std::span<float> planar) {
  const float step = region.size_px / static_cast<float>(side);
  const int samples = std::clamp(static_cast<int>(std::ceil(step - 0.5F)), 1, max_samples_per_axis);
  const Eigen::Vector2f right = region.right() * (step / static_cast<float>(samples));
  const Eigen::Vector2f down = region.down() * (step / static_cast<float>(samples));
  const Eigen::Vector2f first = region.image_from_window(Eigen::Vector2f::Zero()) + 0.5F * (right + down);
  const float weight = scale / static_cast<float>(samples * samples);
  // Positions far outside would overflow an int; the border repeats from here on anyway.
  const float limit_x = static_cast<float>(frame.width_px) + 1.0F;
  const float limit_y = static_cast<float>(frame.height_px) + 1.0F;
  const float edge_x = static_cast<float>(frame.width_px) - 0.5F;
  const float edge_y = static_cast<float>(frame.height_px) - 0.5F;

  const auto plane = static_cast<std::size_t>(side) * static_cast<std::size_t>(side);
  std::size_t out = 0;
  for (int row = 0; row < side; ++row) {
    for (int column = 0; column < side; ++column, ++out) {
      Rgb sum{};
      for (int i = 0; i < samples; ++i) {
        const Eigen::Vector2f line = first + static_cast<float>(row * samples + i) * down;
        for (int k = 0; k < samples; ++k) {
          const Eigen::Vector2f at = line + static_cast<float>(column * samples + k) * right;
          if (border == Border::Black &&
              (at.x() < -0.5F || at.y() < -0.5F || at.x() > edge_x || at.y() > edge_y)) {
            continue;
          }
          const float x = std::clamp(at.x(), -1.0F, limit_x);
          const float y = std::clamp(at.y(), -1.0F, limit_y);
          if (samples == 1) {
            add_bilinear(frame, x, y, sum);
          } else {
            const std::uint8_t* pixel =
                clamped_pixel(frame, static_cast<int>(x + 0.5F), static_cast<int>(y + 0.5F));
            for (std::size_t c = 0; c < 4; ++c) {
              sum[c] += pixel[c];
            }
          }
        }
      }
      planar[out] = weight * sum[0] + offset;
      planar[plane + out] = weight * sum[1] + offset;
      planar[2 * plane + out] = weight * sum[2] + offset;
    }
  }
}

}  // namespace facet::track
