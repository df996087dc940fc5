#include "stereo/islands.hpp"

#include <algorithm>
#include <cmath>

namespace facet::stereo {

Islands::Islands(int width_px, int height_px) : width_(width_px) {
  seen_.resize(static_cast<std::size_t>(width_px) * static_cast<std::size_t>(height_px));
  open_.reserve(seen_.size());
  piece_.reserve(seen_.size());
}

void Islands::drop(std::span<const float> values, float break_at, int least_px, std::span<float> depth_mm) {
  const auto width = static_cast<std::size_t>(width_);
  std::fill(seen_.begin(), seen_.end(), std::uint8_t{0});
  for (std::size_t seed = 0; seed < seen_.size(); ++seed) {
    if (seen_[seed] != 0 || !(depth_mm[seed] > 0)) {
      continue;
    }
    seen_[seed] = 1;
    open_.assign(1, seed);
    piece_.clear();
    while (!open_.empty()) {
      const std::size_t at = open_.back();
      open_.pop_back();
      piece_.push_back(at);
      const auto visit = [&](bool there, std::size_t next) {
        if (there && seen_[next] == 0 && depth_mm[next] > 0 &&
            std::abs(values[next] - values[at]) <= break_at) {
          seen_[next] = 1;
          open_.push_back(next);
        }
      };
      const std::size_t x = at % width;
      visit(x > 0, at - 1);
      visit(x + 1 < width, at + 1);
      visit(at >= width, at - width);
      visit(at + width < seen_.size(), at + width);
    }
    if (piece_.size() < static_cast<std::size_t>(std::max(least_px, 0))) {
      for (const std::size_t at : piece_) {
        depth_mm[at] = 0;
      }
    }
  }
}

}  // namespace facet::stereo
