#pragma once

#include <array>

namespace facet::maths {

/// SH(n), the basis of shading: spherical harmonics up to the second order without their constants
/// [MD19 eq. 1]. n = (x, y, z), unit; the axes are those of the light's coefficients.
/// shaders/refine/shading.glsl has the same.
template <typename T>
std::array<T, 9> harmonics(T x, T y, T z) {
  return {T{1}, x, y, z, x * y, x * z, y * z, x * x - y * y, 3 * z * z - 1};
}

}  // namespace facet::maths
