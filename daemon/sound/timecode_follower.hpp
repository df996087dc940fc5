#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "sound/ltc_reader.hpp"
#include "take/take_time.hpp"

namespace facet::sound {

/// Follows timecode: spans of time in which it runs on (take::TimecodeSpan), out of frames as they are heard.
///
/// Timecode counts once kFramesToLock frames in a row agree, from the first of them on. Then single frames
/// may be missing, or wrong, and for kFlywheel_ns none need come. A jump, another direction and, where its
/// clock wanders off by a tenth of a frame, the clock's other speed begin a new span. Another rate begins all
/// anew. One thread.
class TimecodeFollower {
 public:
  static constexpr int kFramesToLock = 8;
  static constexpr std::int64_t kFlywheel_ns = 2'000'000'000;

  /// frame: as heard. first_ns, end_ns: CLOCK_MONOTONIC of its beginning and end.
  void add(const LtcFrame& frame, std::int64_t first_ns, std::int64_t end_ns);

  /// Of the spans that end after since_ns; TimecodeSource::None where there is none.
  take::TakeTimecode timecode(std::int64_t since_ns) const;

 private:
  struct Heard {
    std::int64_t first_ns = 0;
    std::int64_t count = 0;
  };
  /// Frames that follow one another, and the line through their times.
  struct Run {
    take::TimecodeRate rate;
    int direction = 1;
    std::deque<Heard> newest;   ///< kFramesToLock at most
    std::int64_t first_ns = 0;  ///< of its first frame
    std::int64_t first_count = 0;
    std::int64_t frames = 0;  ///< heard
    // Sums over frames, of x: frames since the first, y: their time beside the nominal one, ns.
    double x = 0;
    double y = 0;
    double xx = 0;
    double xy = 0;

    void begin(const Heard& heard, const take::TimecodeRate& with_rate, int with_direction);
    bool goes_on_with(const Heard& heard) const;
    void add(const Heard& heard);
    double nominal_ns() const { return 1e9 / rate.hz(); }
    /// Frames from its first to this one, by the time; what is left over is how far it is beside, frames.
    double frames_to(std::int64_t time_ns) const;
    take::TimecodeSpan span() const;
  };

  void lock(Run run);

  std::optional<Run> run_;                 ///< that counts
  std::optional<Run> next_;                ///< does not fit to it, and may take its place
  std::vector<take::TimecodeSpan> ended_;  ///< of `rate_`
  take::TimecodeRate rate_;
};

}  // namespace facet::sound
