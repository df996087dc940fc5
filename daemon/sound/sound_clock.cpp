#include "sound/sound_clock.hpp"

#include <algorithm>
#include <cmath>

#include "maths/statistics.hpp"

namespace facet::sound {
namespace {

constexpr std::int64_t kWindow_ns = 20'000'000'000;
constexpr std::int64_t kApart_ns = 50'000'000;
constexpr std::int64_t kSettled_ns = 1'000'000'000;
constexpr std::size_t kLeastPoints = 8;
constexpr int kRounds = 3;
constexpr double kFarOff = 3;
/// Below this all is as good as can be.
constexpr double kNear_ns = 1000;

struct Line {
  double offset_ns = 0;
  double step_ns = 0;
};

/// Least squares of points (x samples, y ns) with weights 0 or 1.
Line line_through(const std::vector<double>& x, const std::vector<double>& y, const std::vector<bool>& used) {
  double count = 0;
  double mean_x = 0;
  double mean_y = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (used[i]) {
      count += 1;
      mean_x += x[i];
      mean_y += y[i];
    }
  }
  mean_x /= count;
  mean_y /= count;
  double xx = 0;
  double xy = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (used[i]) {
      xx += (x[i] - mean_x) * (x[i] - mean_x);
      xy += (x[i] - mean_x) * (y[i] - mean_y);
    }
  }
  const double step = xx > 0 ? xy / xx : 0;
  return {mean_y - step * mean_x, step};
}

}  // namespace

SoundClock::SoundClock(int nominal_hz) : nominal_step_ns_(1e9 / nominal_hz), step_ns_(nominal_step_ns_) {}

void SoundClock::restart() {
  points_.clear();
}

void SoundClock::add(std::int64_t sample, std::int64_t time_ns) {
  if (!points_.empty() && (time_ns - points_.back().time_ns < kApart_ns || sample <= points_.back().sample)) {
    return;
  }
  points_.push_back({sample, time_ns});
  const auto young = std::find_if(points_.begin(), points_.end(),
                                  [&](const Point& point) { return time_ns - point.time_ns <= kWindow_ns; });
  points_.erase(points_.begin(), young);
  fit();
}

void SoundClock::fit() {
  sample_0_ = points_.front().sample;
  time_0_ns_ = points_.front().time_ns;
  std::vector<double> x;
  std::vector<double> y;
  for (const Point& point : points_) {
    x.push_back(static_cast<double>(point.sample - sample_0_));
    y.push_back(static_cast<double>(point.time_ns - time_0_ns_));
  }
  std::vector<bool> used(points_.size(), true);
  const bool measured = points_.size() >= kLeastPoints && points_.back().time_ns - time_0_ns_ >= kSettled_ns;
  for (int round = 0; round < kRounds; ++round) {
    if (measured) {
      const Line line = line_through(x, y, used);
      offset_ns_ = line.offset_ns;
      step_ns_ = line.step_ns;
      settled_ = true;
    } else {
      std::vector<double> offsets;
      for (std::size_t i = 0; i < x.size(); ++i) {
        offsets.push_back(y[i] - x[i] * step_ns_);
      }
      offset_ns_ = maths::median_of(offsets);
    }
    std::vector<double> distances;
    for (std::size_t i = 0; i < x.size(); ++i) {
      distances.push_back(std::abs(y[i] - offset_ns_ - x[i] * step_ns_));
    }
    auto sorted = distances;
    const double most = std::max(kNear_ns, kFarOff * maths::median_of(sorted));
    std::transform(distances.begin(), distances.end(), used.begin(),
                   [&](double distance) { return distance <= most; });
  }
}

std::int64_t SoundClock::time_of(double sample) const {
  return points_.empty()
             ? 0
             : time_0_ns_ + std::llround(offset_ns_ + (sample - static_cast<double>(sample_0_)) * step_ns_);
}

double SoundClock::sample_at(std::int64_t time_ns) const {
  return static_cast<double>(sample_0_) + (static_cast<double>(time_ns - time_0_ns_) - offset_ns_) / step_ns_;
}

}  // namespace facet::sound
