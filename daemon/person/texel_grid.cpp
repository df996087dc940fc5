#include "person/texel_grid.hpp"

#include <cstddef>

namespace facet::person {

TexelGrid::TexelGrid(int width_texels, int height_texels, const std::vector<char>& held)
    : width(width_texels), height(height_texels) {
  std::vector<std::int32_t> index(held.size(), -1);
  for (std::size_t p = 0; p < held.size(); ++p) {
    if (held[p] != 0) {
      index[p] = static_cast<std::int32_t>(place.size());
      place.push_back(static_cast<std::int32_t>(p));
    }
  }
  const auto at = [&](int row, int column) {
    return row < 0 || column < 0 || row >= height || column >= width
               ? -1
               : index[static_cast<std::size_t>(row * width + column)];
  };
  for (std::size_t i = 0; i < place.size(); ++i) {
    const int row = place[i] / width;
    const int column = place[i] % width;
    down.push_back(at(row + 1, column));
    up.push_back(at(row - 1, column));
    if (at(row, column + 1) >= 0 && down[i] >= 0) {
      open.push_back(static_cast<std::int32_t>(i));
      if (at(row, column - 1) >= 0 && up[i] >= 0) {
        inner.push_back(static_cast<std::int32_t>(i));
      }
    }
  }
}

}  // namespace facet::person
