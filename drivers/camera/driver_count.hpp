#pragma once

#include <cstdint>
#include <optional>

namespace facet::camera {

/// A driver's time stamp in CLOCK_MONOTONIC: it is taken for that where it lies between `earliest_ns` and
/// `now_ns`, with a little slack; else for a time of the other clock, where there may be one. None where it
/// fits neither.
///
/// other_now_ns  what the other clock shows now
std::optional<std::int64_t> monotonic_stamp_ns(std::int64_t stamp_ns, std::int64_t earliest_ns,
                                               std::int64_t now_ns, std::optional<std::int64_t> other_now_ns);

/// Carries the frame numbers of a driver, which have 32 bits, wrap and begin anew with every stream, over to
/// Frame::sequence, and finds what is missing between two frames. One thread.
class DriverCount {
 public:
  struct Step {
    std::uint64_t sequence = 0;
    std::uint64_t lost = 0;     ///< CameraCounters::lost
    std::uint64_t omitted = 0;  ///< CameraCounters::omitted
  };

  /// period_ns  between two frames, nominally
  explicit DriverCount(std::int64_t period_ns) : period_ns_(period_ns) {}

  void begin_stream();

  /// The stream rested: what lies between the newest frame and the next is no omission.
  void resume() { stamp_ns_.reset(); }

  /// The next frame that the driver hands out.
  ///
  /// number    of the driver
  /// stamp_ns  of the driver; none where it makes no sense
  Step next(std::uint32_t number, std::optional<std::int64_t> stamp_ns);

 private:
  std::uint32_t advance(std::uint32_t number);
  std::uint64_t count_omitted(std::int64_t passed_ns, std::uint32_t step);

  std::int64_t period_ns_;
  std::optional<std::uint64_t> sequence_;
  std::optional<std::uint32_t> number_;   ///< of the newest frame of this stream
  std::optional<std::int64_t> stamp_ns_;  ///< of the newest frame of this stream
  double lag_ = 0;                        ///< of the newest frame's time, see count_omitted
};

}  // namespace facet::camera
