#include "camera/driver_count.hpp"

#include <algorithm>
#include <cmath>

namespace facet::camera {

std::optional<std::int64_t> monotonic_stamp_ns(std::int64_t stamp_ns, std::int64_t earliest_ns,
                                               std::int64_t now_ns,
                                               std::optional<std::int64_t> other_now_ns) {
  /// Times of a driver that estimates the device's clock may lie a little in the future, or before the
  /// stream.
  constexpr std::int64_t kSlack_ns = 100'000'000;
  const auto fits = [&](std::int64_t time_ns) {
    return time_ns >= earliest_ns - kSlack_ns && time_ns <= now_ns + kSlack_ns;
  };
  if (!fits(stamp_ns) && other_now_ns) {
    stamp_ns -= *other_now_ns - now_ns;
  }
  return fits(stamp_ns) ? std::optional(std::min(stamp_ns, now_ns)) : std::nullopt;
}

void DriverCount::begin_stream() {
  number_.reset();
  stamp_ns_.reset();
  lag_ = 0;
}

DriverCount::Step DriverCount::next(std::uint32_t number, std::optional<std::int64_t> stamp_ns) {
  const std::uint32_t step = advance(number);
  Step found;
  found.sequence = *sequence_;
  found.lost = step - 1;
  if (stamp_ns && stamp_ns_) {
    found.omitted = count_omitted(*stamp_ns - *stamp_ns_, step);
  } else {
    lag_ = 0;
  }
  stamp_ns_ = stamp_ns;
  return found;
}

/// Returns by how much the number went on.
std::uint32_t DriverCount::advance(std::uint32_t number) {
  /// A jump by more is no loss but another count.
  constexpr std::uint32_t kMostLost = 10'000;
  std::uint32_t step = 1;
  if (!number_) {
    // What was between two streams is at least one frame.
    sequence_ = sequence_ ? *sequence_ + 2 : 0;
  } else {
    step = number - *number_;
    if (step == 0 || step > kMostLost) {
      step = 1;  // a driver that does not count, or began anew
    }
    *sequence_ += step;
  }
  number_ = number;
  return step;
}

/// Counts what the device left out in silence: the times go on, the numbers don't. `lag_` is by how many
/// periods the times are behind the numbers, since they were least so. A driver that stamps some frames late
/// makes it rise and fall; a frame is missing where two in a row lag by almost a period.
std::uint64_t DriverCount::count_omitted(std::int64_t passed_ns, std::uint32_t step) {
  constexpr double kWhole = 0.75;       // of a period is taken for one
  constexpr double kForgotten = 0.002;  // of a period with each frame: clocks differ
  const double lag_before = lag_;
  const double periods = static_cast<double>(passed_ns) / static_cast<double>(period_ns_);
  lag_ = std::max(0.0, lag_ + periods - static_cast<double>(step) - kForgotten);
  const double missing = std::floor(std::min(lag_before, lag_) + 1 - kWhole);
  if (missing < 1) {
    return 0;
  }
  lag_ -= missing;
  return static_cast<std::uint64_t>(missing);
}

}  // namespace facet::camera
