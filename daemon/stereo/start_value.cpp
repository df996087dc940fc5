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
  row_sums_.resize(width * count_);
  reversed_.resize(width + 2 * (count_ + static_cast<std::size_t>(std::abs(least_px))));
  right_cost_.resize(reversed_.size());
  right_best_.resize(reversed_.size());
  paths_.resize(std::size_t{8} * (width + 2) * (count_ + 2 * kLanes));
  path_least_.resize(std::size_t{8} * (width + 2));
  columns_.resize(3 * width);
  costs_.reserve(pixels * count_);
  totals_.reserve(pixels * count_);
}

std::size_t StartValue::bytes() const {
  const auto of = [](const auto&... arrays) {
    return (std::size_t{0} + ... + (arrays.capacity() * sizeof(arrays.front())));
  };
  std::size_t sum = of(left_lit_, right_lit_, costs_, totals_, row_sums_, reversed_, right_cost_, right_best_,
                       paths_, path_least_, columns_);
  for (std::size_t slot = 0; slot < left_.size(); ++slot) {
    sum += of(left_[slot], right_[slot]);
  }
  return sum;
}

/// Takes mean and contrast of the surroundings out, so that gain and bias of either camera do not count. In
/// the box's rows.
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
  for (int y = box_.y - kNormaliseY; y < box_.y + kNormaliseY; ++y) {
    add_row(y, 1);
  }
  for (int y = box_.y; y < box_.past_y; ++y) {
    add_row(y + kNormaliseY, 1);
    if (y > box_.y) {
      add_row(y - kNormaliseY - 1, -1);
    }
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
  const auto first = static_cast<std::size_t>(std::max(box_.x - 1, 0));
  const auto past = static_cast<std::size_t>(std::min(box_.past_x + 1, width_));
  std::fill(row_sums_.begin() + static_cast<std::ptrdiff_t>(first * count_),
            row_sums_.begin() + static_cast<std::ptrdiff_t>(past * count_), std::uint16_t{0});
  const std::size_t margin = count_ + static_cast<std::size_t>(std::abs(least_));
  for (std::size_t slot = 0; slot < slot_count; ++slot) {
    const std::uint8_t* left = left_[slot].data() + static_cast<std::size_t>(row) * width;
    const std::uint8_t* right = right_[slot].data() + static_cast<std::size_t>(row) * width;
    std::fill(reversed_.begin(), reversed_.end(), std::uint8_t{0});
    std::reverse_copy(right, right + width, reversed_.begin() + static_cast<std::ptrdiff_t>(margin));
    for (std::size_t x = first; x < past; ++x) {
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
  for (int x = box_.x; x < box_.past_x; ++x) {
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
  std::fill(start_px.begin(), start_px.end(), std::numeric_limits<float>::quiet_NaN());
  if (!find_box()) {
    return;
  }
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
    return;
  }
  for (int y = box_.y; y < box_.past_y; ++y) {
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

/// The least box around what is lit on the left, with a pixel on either side, since costs reach so far; false
/// where nothing is. Around it all disparities cost the same, and paths that come from there prefer none.
bool StartValue::find_box() {
  box_ = {width_, 0, height_, 0};
  for (int y = 0; y < height_; ++y) {
    const auto row = left_lit_.begin() + static_cast<std::ptrdiff_t>(y) * width_;
    const auto end = row + width_;
    const auto first = std::find(row, end, std::uint8_t{1});
    if (first != end) {
      const auto last = std::find(std::reverse_iterator(end), std::reverse_iterator(row), std::uint8_t{1});
      box_ = {std::min(box_.x, static_cast<int>(first - row)),
              std::max(box_.past_x, static_cast<int>(last.base() - row)), std::min(box_.y, y), y + 1};
    }
  }
  if (box_.past_y == 0) {
    return false;
  }
  box_.x = std::max(box_.x - 1, 0);
  box_.past_x = std::min(box_.past_x + 1, width_);
  const std::size_t cells = static_cast<std::size_t>(box_.past_x - box_.x) *
                            static_cast<std::size_t>(box_.past_y - box_.y) * count_;
  if (cells > costs_.size()) {
    costs_.resize(cells);
    totals_.resize(cells);
  }
  return true;
}

/// One pixel of some paths:
///   L(p, d) = C(p, d) + min(L(q, d), L(q, d -+ 1) + P1, min_k L(q, k) + P2) - min_k L(q, k), q before p
/// previous   [path] L(q, .), with a margin of a disparity on both sides
/// least      [path] min_k L(q, k); out: of p
/// current    [path] out
/// total      the sum over the paths is added, or where `fresh` written
template <bool fresh, std::size_t paths>
void StartValue::advance(const std::uint8_t* __restrict cost,
                         const std::array<const std::uint16_t*, paths>& previous,
                         std::array<std::uint16_t, paths>& least,
                         const std::array<std::uint16_t*, paths>& current,
                         std::uint16_t* __restrict total) const {
  const auto step_cost = static_cast<std::uint16_t>(options_.step_cost);
  const auto jump_cost = static_cast<std::uint16_t>(options_.jump_cost);
  for (std::size_t path = 0; path < paths; ++path) {
    const std::uint16_t* from = previous[path];
    std::uint16_t* __restrict to = current[path];
    const std::uint16_t before = least[path];
    const auto jump = static_cast<std::uint16_t>(before + jump_cost);
    std::uint16_t smallest = kForbidden;
    for (std::size_t k = 0; k < count_; ++k) {
      const std::uint16_t* own = from + k;
      const auto beside = static_cast<std::uint16_t>(std::min(own[-1], own[1]) + step_cost);
      const std::uint16_t best = std::min(std::min(own[0], beside), jump);
      const auto value = static_cast<std::uint16_t>(cost[k] + best - before);
      to[k] = value;
      total[k] = static_cast<std::uint16_t>(fresh && path == 0 ? value : total[k] + value);
      smallest = std::min(smallest, value);
    }
    least[path] = smallest;
  }
}

/// Half of the paths: those that come from above and the left, or backward from below and the right.
template <bool backward, std::size_t paths>
void StartValue::sweep() {
  const std::size_t stride = count_ + 2 * kLanes;
  const std::size_t columns = static_cast<std::size_t>(width_) + 2;
  // Zeros with forbidden margins: what lies outside the box prefers nothing.
  std::fill(path_least_.begin(), path_least_.end(), std::uint16_t{0});
  for (std::size_t c = 0; c < 8 * columns; ++c) {
    std::uint16_t* values = paths_.data() + c * stride;
    std::fill(values, values + kLanes, kForbidden);
    std::fill(values + kLanes, values + kLanes + count_, std::uint16_t{0});
    std::fill(values + kLanes + count_, values + stride, kForbidden);
  }
  constexpr std::ptrdiff_t forward = backward ? -1 : 1;
  // Of the sweep's paths: along the row, from the row before straight, and diagonal on either side.
  constexpr std::array<std::ptrdiff_t, 4> shift{-forward, 0, -forward, forward};
  for (int line = 0; line < box_.past_y - box_.y; ++line) {
    const int y = backward ? box_.past_y - 1 - line : box_.y + line;
    const auto now = static_cast<std::size_t>(line % 2);
    const auto place = [&](std::size_t path, std::size_t column) {
      const std::size_t buffer = path == 0 ? now : 1 - now;
      return (buffer * 4 + path) * columns + column;
    };
    for (int step = 0; step < box_.past_x - box_.x; ++step) {
      const int x = backward ? box_.past_x - 1 - step : box_.x + step;
      std::array<const std::uint16_t*, paths> previous;
      std::array<std::uint16_t*, paths> current;
      std::array<std::uint16_t, paths> least;
      for (std::size_t path = 0; path < paths; ++path) {
        const std::size_t from = place(path, static_cast<std::size_t>(x + 1 + shift[path]));
        previous[path] = paths_.data() + from * stride + kLanes;
        least[path] = path_least_[from];
        current[path] =
            paths_.data() + ((now * 4 + path) * columns + static_cast<std::size_t>(x + 1)) * stride + kLanes;
      }
      advance<!backward>(costs(x, y), previous, least, current, totals(x, y));
      for (std::size_t path = 0; path < paths; ++path) {
        path_least_[(now * 4 + path) * columns + static_cast<std::size_t>(x + 1)] = least[path];
      }
    }
  }
}

void StartValue::semi_global(std::span<float> start_px) {
  if (options_.path_count == 8) {
    sweep<false, 4>();
    sweep<true, 4>();
  } else {
    sweep<false, 2>();
    sweep<true, 2>();
  }
  for (int y = box_.y; y < box_.past_y; ++y) {
    choose(y, start_px.subspan(static_cast<std::size_t>(y) * static_cast<std::size_t>(width_),
                               static_cast<std::size_t>(width_)));
  }
}

/// The best disparity of each pixel of a row, checked against the best of the right picture's pixels.
void StartValue::choose(int row, std::span<float> line_px) {
  constexpr std::uint16_t kMost = std::numeric_limits<std::uint16_t>::max();
  // Backwards and with margins, so that a pixel's disparities lie side by side: right pixel x - least - k is
  // at place_of(x) + k.
  const auto place_of = [&](int x) {
    return count_ + static_cast<std::size_t>(std::abs(least_) + width_ - 1 - x + least_);
  };
  std::fill(right_cost_.begin(), right_cost_.end(), kMost);
  const std::uint8_t* lit =
      left_lit_.data() + static_cast<std::size_t>(row) * static_cast<std::size_t>(width_);
  for (int x = box_.x; x < box_.past_x; ++x) {
    if (lit[x] == 0) {
      continue;
    }
    const std::uint16_t* __restrict total = totals(x, row);
    std::uint16_t* __restrict cost = right_cost_.data() + place_of(x);
    std::uint16_t* __restrict best = right_best_.data() + place_of(x);
    for (std::size_t k = 0; k < used_; ++k) {
      const bool less = total[k] < cost[k];
      cost[k] = less ? total[k] : cost[k];
      best[k] = less ? static_cast<std::uint16_t>(k) : best[k];
    }
  }
  const auto least_of = [](const std::uint16_t* first, const std::uint16_t* past) {
    std::uint16_t least = kMost;
    for (; first < past; ++first) {
      least = std::min(least, *first);
    }
    return least;
  };
  for (int x = box_.x; x < box_.past_x; ++x) {
    if (lit[x] == 0) {
      continue;
    }
    const std::uint16_t* total = totals(x, row);
    const std::uint16_t smallest = least_of(total, total + used_);
    const auto best = static_cast<std::size_t>(std::find(total, total + used_, smallest) - total);
    const int there = x - least_ - static_cast<int>(best);
    if (there < 0 || there >= width_ || costs(x, row)[best] > options_.most_cost) {
      continue;
    }
    if (std::abs(static_cast<int>(right_best_[place_of(x) + best]) - static_cast<int>(best)) > 1) {
      continue;  // left-right check
    }
    const std::uint16_t second = std::min(least_of(total, total + best - std::min<std::size_t>(best, 1)),
                                          least_of(total + std::min(best + 2, used_), total + used_));
    if (static_cast<float>(second) < (1 + options_.uniqueness) * static_cast<float>(smallest)) {
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
    line_px[static_cast<std::size_t>(x)] = static_cast<float>(least_) + static_cast<float>(best) + fraction;
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
  const auto first = static_cast<std::size_t>(box_.x);
  for (int y = box_.y; y < box_.past_y; ++y) {
    std::fill(before.begin(), before.end(), 0);
    for (std::size_t x = first; x < static_cast<std::size_t>(box_.past_x); ++x) {
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
    for (std::size_t x = static_cast<std::size_t>(box_.past_x); x-- > first;) {
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
