#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace facet::sound {

/// When the samples of a source were taken. Its clock is a quartz of its own, some ten-thousandths beside
/// CLOCK_MONOTONIC; what the system says of it comes in steps and sometimes late. So a line
///
///   time_ns(sample) = time_0 + (sample - sample_0) * step_ns
///
/// is laid through what it said over the last seconds: least squares, twice anew without what lies farther
/// off than three times the median distance. One thread.
class SoundClock {
 public:
  /// nominal_hz: what the source says. Until a second has been seen, that is the step.
  explicit SoundClock(int nominal_hz);

  /// The first `sample` samples had been taken at time_ns (CLOCK_MONOTONIC); rising.
  void add(std::int64_t sample, std::int64_t time_ns);
  /// Forgets what was said: samples are counted on, but their source began anew.
  void restart();

  bool empty() const { return points_.empty(); }
  /// Whether the step is measured.
  bool settled() const { return settled_; }
  /// CLOCK_MONOTONIC of a sample's beginning, ns; of times before the first add() 0.
  std::int64_t time_of(double sample) const;
  /// The other way round.
  double sample_at(std::int64_t time_ns) const;
  double rate_hz() const { return 1e9 / step_ns_; }

 private:
  struct Point {
    std::int64_t sample = 0;
    std::int64_t time_ns = 0;
  };
  void fit();

  double nominal_step_ns_;
  std::vector<Point> points_;  ///< the oldest first
  std::int64_t sample_0_ = 0;
  std::int64_t time_0_ns_ = 0;
  double offset_ns_ = 0;
  double step_ns_;
  bool settled_ = false;
};

}  // namespace facet::sound
