#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <vector>

#include "facet/clock.hpp"
#include "studio/studio.hpp"

namespace facet::studio {

/// The last durations, ms.
class Times {
 public:
  void add(Clock::duration took) {
    const float ms = std::chrono::duration<float, std::milli>(took).count();
    if (kept_.size() < kKept) {
      kept_.push_back(ms);
    } else {
      kept_[next_] = ms;
      next_ = (next_ + 1) % kKept;
    }
  }
  void clear() {
    kept_.clear();
    next_ = 0;
  }
  StudioTimes figures() const {
    if (kept_.empty()) {
      return {};
    }
    std::vector<float> sorted = kept_;
    std::sort(sorted.begin(), sorted.end());
    float sum = 0;
    for (const float one : sorted) {
      sum += one;
    }
    return {sum / static_cast<float>(sorted.size()), sorted[(sorted.size() - 1) * 95 / 100], sorted.back()};
  }

 private:
  static constexpr std::size_t kKept = 256;

  std::vector<float> kept_;
  std::size_t next_ = 0;
};

}  // namespace facet::studio
