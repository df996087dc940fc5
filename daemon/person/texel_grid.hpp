#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace facet::person {

/// Texels in the order of the chart's rows, and which of them lie beside each other.
struct TexelGrid {
  /// held  [height][width] 1: the texel is one of them
  TexelGrid(int width, int height, const std::vector<char>& held);

  Eigen::Index count() const { return static_cast<Eigen::Index>(place.size()); }

  int width, height;
  std::vector<std::int32_t> place;  ///< [count] row major index in the chart; rising
  std::vector<std::int32_t> down;   ///< [count] the texel of the next row, -1 where it is none of them
  std::vector<std::int32_t> up;     ///< [count] of the row before
  std::vector<std::int32_t> open;   ///< those that have one to the right, the next, and one below
  std::vector<std::int32_t> inner;  ///< those that have all four neighbours
};

}  // namespace facet::person
