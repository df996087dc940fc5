#pragma once

#include <cmath>
#include <functional>
#include <memory>

#include "facet/frame.hpp"

namespace facet::fit {

/// A picture of a smooth function.
inline Frame painted(int width, int height, const std::function<float(float, float)>& grey) {
  Frame frame;
  frame.width_px = width;
  frame.height_px = height;
  frame.stride_bytes = 4 * static_cast<std::size_t>(width);
  auto pixels = std::make_shared<std::uint8_t[]>(frame.stride_bytes * static_cast<std::size_t>(height));
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      std::uint8_t* at =
          pixels.get() + static_cast<std::size_t>(y) * frame.stride_bytes + 4 * static_cast<std::size_t>(x);
      at[0] = at[1] = at[2] =
          static_cast<std::uint8_t>(std::lround(grey(static_cast<float>(x), static_cast<float>(y))));
      at[3] = 255;
    }
  }
  frame.pixels = std::move(pixels);
  return frame;
}

inline float texture(float x, float y) {
  return 128 + 40 * std::sin(0.21F * x + 0.4F * std::sin(0.07F * y)) +
         40 * std::sin(0.17F * y + 0.5F * std::cos(0.05F * x));
}

}  // namespace facet::fit
