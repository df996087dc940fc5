#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace facet::maths {

/// The transfer of sRGB (IEC 61966-2-1): the linear value of an encoded one, 0 to 1.
template <typename T>
T decode_srgb(T encoded) {
  return encoded <= static_cast<T>(0.04045L)
             ? encoded / static_cast<T>(12.92L)
             : std::pow((encoded + static_cast<T>(0.055L)) / static_cast<T>(1.055L), static_cast<T>(2.4L));
}

/// [256] the linear value of every encoded byte.
inline const std::array<float, 256>& decoded_srgb8() {
  static const std::array<float, 256> values = [] {
    std::array<float, 256> out{};
    for (std::size_t i = 0; i < out.size(); ++i) {
      out[i] = static_cast<float>(decode_srgb(static_cast<double>(i) / 255));
    }
    return out;
  }();
  return values;
}

/// The encoded value of a linear one, 0 to 1.
inline float encode_srgb(float linear) {
  return linear <= 0.0031308F ? 12.92F * linear : 1.055F * std::pow(linear, 1.0F / 2.4F) - 0.055F;
}

}  // namespace facet::maths
