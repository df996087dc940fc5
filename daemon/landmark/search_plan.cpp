#include "landmark/search_plan.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace facet::landmark {

void list_search_windows(int width_px, int height_px, std::vector<Region>& windows) {
  constexpr float quarter = std::numbers::pi_v<float> / 2;
  constexpr float tile_step = 0.6F;  ///< of a tile: a face of 0.4 tiles lies whole in at least one
  const auto width = static_cast<float>(width_px);
  const auto height = static_cast<float>(height_px);
  const float short_side = std::min(width, height);
  windows.clear();
  const auto add_tiles = [&](float size, float rotation) {
    const auto count = [&](float extent) {
      return extent <= size ? 1 : 1 + static_cast<int>(std::ceil((extent - size) / (size * tile_step)));
    };
    const int columns = count(width);
    const int rows = count(height);
    const auto place = [&](float extent, int index, int number) {
      return number == 1 ? 0.5F * (extent - 1)
                         : 0.5F * (size - 1) +
                               (extent - size) * static_cast<float>(index) / static_cast<float>(number - 1);
    };
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        windows.push_back({{place(width, column, columns), place(height, row, rows)}, size, rotation});
      }
    }
  };
  const float whole = std::max(width, height);
  const float half = 0.5F * short_side;
  const bool has_short_level = short_side < whole;
  add_tiles(whole, 0);
  if (has_short_level) {
    add_tiles(short_side, 0);
  }
  for (const float rotation : {quarter, -quarter, 0.5F * quarter, -0.5F * quarter}) {
    add_tiles(whole, rotation);
  }
  add_tiles(half, 0);
  for (const float rotation : {quarter, -quarter}) {
    if (has_short_level) {
      add_tiles(short_side, rotation);
    }
    add_tiles(half, rotation);
  }
}

}  // namespace facet::landmark
