#include "stereo/start_value.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>

#include "facet/error.hpp"

namespace facet::stereo {
namespace {

// Disparities are handled in whole vectors of 16 costs.
constexpr std::size_t kLanes = 16;
// Reach of the window whose mean and contrast are taken out of the pictures before they are compared.
constexpr int kNormaliseX = 8;
constexpr int kNormaliseY = 3;
// A contrast (standard deviation of grey) below which a window says nothing.
constexpr double kLeastContrast = 0.01;
// Normalised grey: 128 + 48 standard deviations. Differences are cut, so that one bad pixel has bounded
// weight.
constexpr double kNormalisedScale = 48;
constexpr std::uint8_t kMostDifference = 128;
// What a left pixel costs that says nothing: between a match and none. A right one that says nothing is none.
constexpr std::uint8_t kUnknownCost = 48;

constexpr std::uint16_t kForbidden = 0x7000;

}  // namespace

StartValue::StartValue(int width_px, int height_px, int least_px, int most_px, const StartOptions& options)
    : width_(width_px), height_(height_px), least_(least_px), options_(options) {
  if (width_px < 3 || height_px < 1 || most_px < least_px || most_px - least_px >= width_px) {
    throw Error(ErrorKind::Usage, fmt::format("disparities from {} to {} px in pictures of {} x {} px",
                                              least_px, most_px, width_px, height_px));
  }
  if (options.window_t < 1 || options.window_t % 2 == 0 ||
      (options.path_count != 4 && options.path_count != 8)) {
    throw Error(ErrorKind::Usage, "a stereo start value has an odd window of slots and 4 or 8 paths");
  }
  used_ = static_cast<std::size_t>(most_px - least_px + 1);
  count_ = (used_ + kLanes - 1) / kLanes * kLanes;
  const auto width = static_cast<std::size_t>(width_px);
  const std::size_t pixels = width * static_cast<std::size_t>(height_px);
  left_.assign(static_cast<std::size_t>(options.window_t), std::vector<std::uint8_t>(pixels));
  right_ = left_;
  left_lit_.resize(pixels);
  right_lit_.resize(pixels);
  costs_.resize(pixels * count_);
  totals_.resize(pixels * count_);
  row_sums_.resize(width * count_);
  reversed_.resize(width + 2 * (count_ + static_cast<std::size_t>(std::abs(least_px))));
  paths_.resize(std::size_t{8} * (width + 2) * (count_ + 2 * kLanes));
  path_least_.resize(std::size_t{8} * (width + 2));
  columns_.resize(3 * width);
}

/// Takes mean and contrast of the surroundings out, so that gain and bias of either camera do not count.
void StartValue::normalise(std::span<const float> grey, const std::vector<std::uint8_t>& lit,
                           std::vector<std::uint8_t>& out) {
  const auto width = static_cast<std::size_t>(width_);
  std::fill(columns_.begin(), columns_.end(), 0);
  double* counts = columns_.data();
  double* sums = counts + width;
  double* squares = sums + width;
  const auto add_row = [&](int y, double sign) {
    if (y < 0 || y >= height_) {
      return;
    }
    const float* row = grey.data() + static_cast<std::size_t>(y) * width;
    const std::uint8_t* row_lit = lit.data() + static_cast<std::size_t>(y) * width;
    for (std::size_t x = 0; x < width; ++x) {
      if (row[x] >= 0 && row_lit[x] != 0) {
        const auto value = static_cast<double>(row[x]);
        counts[x] += sign;
        sums[x] += sign * value;
        squares[x] += sign * value * value;
      }
    }
  };
  for (int y = 0; y < kNormaliseY; ++y) {
    add_row(y, 1);
  }
  for (int y = 0; y < height_; ++y) {
    add_row(y + kNormaliseY, 1);
    add_row(y - kNormaliseY - 1, -1);
    double n = 0;
    double s = 0;
    double ss = 0;
    const auto add_column = [&](int x, double sign) {
      if (x >= 0 && x < width_) {
        n += sign * counts[x];
        s += sign * sums[x];
        ss += sign * squares[x];
      }
    };
    for (int x = 0; x < kNormaliseX; ++x) {
      add_column(x, 1);
    }
    for (int x = 0; x < width_; ++x) {
      add_column(x + kNormaliseX, 1);
      add_column(x - kNormaliseX - 1, -1);
      const std::size_t at = static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
      out[at] = 0;
      if (grey[at] >= 0 && lit[at] != 0 && n > 0.5) {
        const double mean = s / n;
        const double contrast = std::sqrt(std::max(ss / n - mean * mean, 0.0));
        if (contrast >= kLeastContrast) {
          const double value = 128 + kNormalisedScale * (static_cast<double>(grey[at]) - mean) / contrast;
          out[at] = static_cast<std::uint8_t>(std::clamp(value, 1.0, 255.0));
        }
      }
    }
  }
}

/// Costs of one row: absolute differences over 1 x 3 pixels and the slots [SF04 eq. 2].
void StartValue::row_costs(int row, std::size_t slot_count) {
  const auto width = static_cast<std::size_t>(width_);
  std::fill(row_sums_.begin(), row_sums_.end(), std::uint16_t{0});
  const std::size_t margin = count_ + static_cast<std::size_t>(std::abs(least_));
  for (std::size_t slot = 0; slot < slot_count; ++slot) {
    const std::uint8_t* left = left_[slot].data() + static_cast<std::size_t>(row) * width;
    const std::uint8_t* right = right_[slot].data() + static_cast<std::size_t>(row) * width;
    std::fill(reversed_.begin(), reversed_.end(), std::uint8_t{0});
    std::reverse_copy(right, right + width, reversed_.begin() + static_cast<std::ptrdiff_t>(margin));
    for (std::size_t x = 0; x < width; ++x) {
      std::uint16_t* sums = row_sums_.data() + x * count_;
      const std::uint8_t own = left[x];
      if (own == 0) {
        for (std::size_t k = 0; k < count_; ++k) {
          sums[k] = static_cast<std::uint16_t>(sums[k] + kUnknownCost);
        }
        continue;
      }
      // Right pixel x - d with d = least_ + k.
      const std::uint8_t* other =
          reversed_.data() + static_cast<std::ptrdiff_t>(margin + width - 1 - x) + least_;
      for (std::size_t k = 0; k < count_; ++k) {
        const std::uint8_t there = other[k];
        const auto difference = static_cast<std::uint8_t>(std::max(own, there) - std::min(own, there));
        const std::uint8_t cost = there == 0 ? kMostDifference : std::min(difference, kMostDifference);
        sums[k] = static_cast<std::uint16_t>(sums[k] + cost);
      }
    }
  }
  // Division by 3 slot_count as a multiplication: the quotient is at most 128.
  const auto scale = static_cast<std::uint32_t>(65536 / (3 * slot_count));
  for (int x = 0; x < width_; ++x) {
    const std::uint16_t* before = row_sums_.data() + static_cast<std::size_t>(std::max(x - 1, 0)) * count_;
    const std::uint16_t* own = row_sums_.data() + static_cast<std::size_t>(x) * count_;
    const std::uint16_t* after =
        row_sums_.data() + static_cast<std::size_t>(std::min(x + 1, width_ - 1)) * count_;
    std::uint8_t* out = costs(x, row);
    for (std::size_t k = 0; k < count_; ++k) {
      const auto sum = static_cast<std::uint32_t>(before[k]) + own[k] + after[k];
      out[k] = static_cast<std::uint8_t>((sum * scale) >> 16U);
    }
    std::fill(out + used_, out + count_, std::uint8_t{255});
  }
}

void StartValue::find(const VolumeSize& size, std::span<const float> left, std::span<const float> right,
                      int slot, std::span<float> start_px) {
  const int first_slot = std::max(0, slot - options_.window_t / 2);
  const int last_slot = std::min(size.slots - 1, slot + options_.window_t / 2);
  const auto part = [&](std::span<const float> whole, int near) {
    return whole.subspan(static_cast<std::size_t>(near) * size.slot_voxels(), size.slot_voxels());
  };
  // Around a lit surface lies a rim that it would be matched with, since windows reach over the edge.
  const auto find_lit = [&](std::span<const float> pictures, std::vector<std::uint8_t>& lit) {
    std::fill(lit.begin(), lit.end(), std::uint8_t{0});
    for (int near = first_slot; near <= last_slot; ++near) {
      const std::span<const float> grey = part(pictures, near);
      for (std::size_t at = 0; at < grey.size(); ++at) {
        lit[at] = lit[at] != 0 || grey[at] >= options_.least_grey ? 1 : 0;
      }
    }
  };
  find_lit(left, left_lit_);
  find_lit(right, right_lit_);
  std::size_t slot_count = 0;
  for (int near = first_slot; near <= last_slot; ++near) {
    const auto speaks = [](float value) { return value >= 0; };
    if (std::ranges::any_of(part(left, near), speaks) && std::ranges::any_of(part(right, near), speaks)) {
      normalise(part(left, near), left_lit_, left_[slot_count]);
      normalise(part(right, near), right_lit_, right_[slot_count]);
      ++slot_count;
    }
  }
  if (slot_count == 0) {
    std::fill(start_px.begin(), start_px.end(), std::numeric_limits<float>::quiet_NaN());
    return;
  }
  for (int y = 0; y < height_; ++y) {
    row_costs(y, slot_count);
  }
  if (options_.method == StartMethod::SemiGlobal) {
    semi_global(start_px);
  } else {
    scan_lines(start_px);
  }
  for (std::size_t at = 0; at < size.slot_voxels(); ++at) {
    if (left_lit_[at] == 0) {
      start_px[at] = std::numeric_limits<float>::quiet_NaN();
    }
  }
}

/// Half of the paths: those that come from above and the left, or backward from below and the right.
///   L(p, d) = C(p, d) + min(L(q, d), L(q, d -+ 1) + P1, min_k L(q, k) + P2) - min_k L(q, k), q before p
void StartValue::sweep(bool backward) {
  const std::size_t stride = count_ + 2 * kLanes;
  const std::size_t columns = static_cast<std::size_t>(width_) + 2;
  const auto step_cost = static_cast<std::uint16_t>(options_.step_cost);
  const auto jump_cost = static_cast<std::uint16_t>(options_.jump_cost);
  const auto cell = [&](std::size_t buffer, std::size_t path, std::size_t column) {
    return paths_.data() + ((buffer * 4 + path) * columns + column) * stride + kLanes;
  };
  const auto least = [&](std::size_t buffer, std::size_t path, std::size_t column) -> std::uint16_t& {
    return path_least_[(buffer * 4 + path) * columns + column];
  };
  // Zeros with forbidden margins: what lies outside the picture prefers nothing.
  std::fill(path_least_.begin(), path_least_.end(), std::uint16_t{0});
  for (std::size_t c = 0; c < 8 * columns; ++c) {
    std::uint16_t* values = paths_.data() + c * stride;
    std::fill(values, values + kLanes, kForbidden);
    std::fill(values + kLanes, values + kLanes + count_, std::uint16_t{0});
    std::fill(values + kLanes + count_, values + stride, kForbidden);
  }
  const std::ptrdiff_t forward = backward ? -1 : 1;
  // Of the sweep's paths: along the row, from the row before straight, and diagonal on either side.
  const std::array<std::ptrdiff_t, 4> shift{-forward, 0, -forward, forward};
  const std::size_t path_count = options_.path_count == 8 ? 4 : 2;
  for (int line = 0; line < height_; ++line) {
    const int y = backward ? height_ - 1 - line : line;
    const auto now = static_cast<std::size_t>(line % 2);
    const std::size_t before = 1 - now;
    for (int step = 0; step < width_; ++step) {
      const int x = backward ? width_ - 1 - step : step;
      const std::uint8_t* cost = costs(x, y);
      std::uint16_t* total = totals(x, y);
      for (std::size_t path = 0; path < path_count; ++path) {
        const std::size_t buffer = path == 0 ? now : before;
        const auto from = static_cast<std::size_t>(x + 1 + shift[path]);
        const std::uint16_t* previous = cell(buffer, path, from);
        const std::uint16_t* below = previous - 1;  // the margin, for the first disparity
        const std::uint16_t previous_least = least(buffer, path, from);
        const auto jump = static_cast<std::uint16_t>(previous_least + jump_cost);
        std::uint16_t* current = cell(now, path, static_cast<std::size_t>(x + 1));
        std::uint16_t current_least = kForbidden;
        for (std::size_t k = 0; k < count_; ++k) {
          const auto beside = static_cast<std::uint16_t>(std::min(below[k], previous[k + 1]) + step_cost);
          const std::uint16_t best = std::min(std::min(previous[k], beside), jump);
          const auto value = static_cast<std::uint16_t>(cost[k] + best - previous_least);
          current[k] = value;
          total[k] = static_cast<std::uint16_t>(total[k] + value);
          current_least = std::min(current_least, value);
        }
        least(now, path, static_cast<std::size_t>(x + 1)) = current_least;
      }
    }
  }
}

void StartValue::semi_global(std::span<float> start_px) {
  std::fill(totals_.begin(), totals_.end(), std::uint16_t{0});
  sweep(false);
  sweep(true);
  for (int y = 0; y < height_; ++y) {
    choose(y, start_px.subspan(static_cast<std::size_t>(y) * static_cast<std::size_t>(width_),
                               static_cast<std::size_t>(width_)));
  }
}

/// The best disparity of each pixel of a row, checked against the best of the right picture's pixels.
void StartValue::choose(int row, std::span<float> line_px) {
  constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();
  const auto width = static_cast<std::size_t>(width_);
  std::vector<std::uint16_t>& right_cost = row_sums_;  // reused: [width] best cost, [width] its disparity
  std::fill_n(right_cost.begin(), width, std::numeric_limits<std::uint16_t>::max());
  std::uint16_t* right_best = right_cost.data() + width;
  for (int x = 0; x < width_; ++x) {
    const std::uint16_t* total = totals(x, row);
    const int first = x - least_;
    for (std::size_t k = 0; k < used_; ++k) {
      const int there = first - static_cast<int>(k);
      if (there >= 0 && there < width_ && total[k] < right_cost[static_cast<std::size_t>(there)]) {
        right_cost[static_cast<std::size_t>(there)] = total[k];
        right_best[there] = static_cast<std::uint16_t>(k);
      }
    }
  }
  for (int x = 0; x < width_; ++x) {
    const std::uint16_t* total = totals(x, row);
    const auto best = static_cast<std::size_t>(std::min_element(total, total + used_) - total);
    float& out = line_px[static_cast<std::size_t>(x)];
    out = kNothing;
    const int there = x - least_ - static_cast<int>(best);
    if (there < 0 || there >= width_ || costs(x, row)[best] > options_.most_cost) {
      continue;
    }
    if (std::abs(static_cast<int>(right_best[there]) - static_cast<int>(best)) > 1) {
      continue;  // left-right check
    }
    std::uint16_t second = std::numeric_limits<std::uint16_t>::max();
    for (std::size_t k = 0; k < used_; ++k) {
      if (k + 1 < best || k > best + 1) {
        second = std::min(second, total[k]);
      }
    }
    if (static_cast<float>(second) < (1 + options_.uniqueness) * static_cast<float>(total[best])) {
      continue;
    }
    float fraction = 0;
    if (best > 0 && best + 1 < used_) {
      const float before = total[best - 1];
      const float own = total[best];
      const float after = total[best + 1];
      const float bend = before - 2 * own + after;
      fraction = bend > 0 ? (before - after) / (2 * bend) : 0;
    }
    out = static_cast<float>(least_) + static_cast<float>(best) + fraction;
  }
}

/// The cheapest way through each row [CHRM96]: a match, a left pixel alone (d grows), a right pixel
/// alone (d shrinks); the order of points along the row is kept.
void StartValue::scan_lines(std::span<float> start_px) {
  enum Step : std::uint8_t { kMatch, kLeftAlone, kRightAlone };
  const auto width = static_cast<std::size_t>(width_);
  const int alone = options_.occlusion_cost;
  std::vector<std::uint8_t> steps(width * used_);
  std::vector<int> before(used_ + 1);
  std::vector<int> now(used_ + 1);
  for (int y = 0; y < height_; ++y) {
    std::fill(before.begin(), before.end(), 0);
    for (std::size_t x = 0; x < width; ++x) {
      const std::uint8_t* cost = costs(static_cast<int>(x), y);
      std::uint8_t* step = steps.data() + x * used_;
      for (std::size_t k = 0; k < used_; ++k) {
        const int match = before[k] + cost[k];
        const int left_alone = k > 0 ? before[k - 1] + alone : std::numeric_limits<int>::max();
        now[k] = std::min(match, left_alone);
        step[k] = match <= left_alone ? kMatch : kLeftAlone;
      }
      for (std::size_t k = used_ - 1; k-- > 0;) {
        if (now[k + 1] + alone < now[k]) {
          now[k] = now[k + 1] + alone;
          step[k] = kRightAlone;
        }
      }
      std::swap(before, now);
    }
    std::size_t k = static_cast<std::size_t>(
        std::min_element(before.begin(), before.begin() + static_cast<std::ptrdiff_t>(used_)) -
        before.begin());
    for (std::size_t x = width; x-- > 0;) {
      while (steps[x * used_ + k] == kRightAlone) {
        ++k;
      }
      float& out = start_px[static_cast<std::size_t>(y) * width + x];
      const int there = static_cast<int>(x) - least_ - static_cast<int>(k);
      const bool fits =
          there >= 0 && there < width_ && costs(static_cast<int>(x), y)[k] <= options_.most_cost;
      if (steps[x * used_ + k] == kMatch) {
        out = fits ? static_cast<float>(least_) + static_cast<float>(k)
                   : std::numeric_limits<float>::quiet_NaN();
      } else {
        out = std::numeric_limits<float>::quiet_NaN();
        --k;
      }
    }
  }
}

}  // namespace facet::stereo
