#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

/// What lines a take up with others' recordings: SMPTE timecode (ST 12-1) of its frames, and the sound beside
/// it. docs/sound-and-time.md is the page.
namespace facet::take {

/// How timecode counts. Drop-frame counting leaves out numbers, not frames: 0 and 1 of each minute but every
/// tenth.
struct TimecodeRate {
  int nominal = 30;        ///< frames in a second of the labels
  bool over_1001 = false;  ///< 1000/1001 as fast: 23.976 and 29.97
  bool drop = false;       ///< of nominal 30, over_1001 alone

  double hz() const { return over_1001 ? nominal * 1000.0 / 1001.0 : nominal; }
  /// Frames from 00:00:00:00 to the next.
  std::int64_t frames_a_day() const;
  bool operator==(const TimecodeRate&) const = default;
};

/// "24", "25", "30", "23.976", "29.97", "29.97 drop", and such of other rates.
std::string to_text(const TimecodeRate& rate);
/// Of such a text; nothing where it is none. Rates are 1 to 240.
std::optional<TimecodeRate> timecode_rate(std::string_view text);

/// The fields of a label.
struct TimecodeLabel {
  int hours = 0;
  int minutes = 0;
  int seconds = 0;
  int frames = 0;
};

/// Frames since 00:00:00:00 (of the day) of a label, and the other way round. Numbers that drop-frame
/// counting leaves out count as the next that is there.
std::int64_t frame_count(const TimecodeLabel& label, const TimecodeRate& rate);
TimecodeLabel timecode_label(std::int64_t frame_count, const TimecodeRate& rate);

/// A stretch of time in which timecode runs without a jump.
struct TimecodeSpan {
  std::int64_t first_ns = 0;  ///< CLOCK_MONOTONIC, of the beginning of frame `first_count`
  std::int64_t last_ns = 0;   ///< what is later is not known by it
  std::int64_t first_count = 0;
  double frame_ns = 0;  ///< of a frame; below 0 where it runs backwards

  bool operator==(const TimecodeSpan&) const = default;
};

enum class TimecodeSource {
  None,   ///< a take of recorded footage, or of before there was timecode
  Clock,  ///< the time of day, UTC
  Ltc,    ///< linear timecode of an audio input
};
const char* to_string(TimecodeSource source);

/// The timecode of a take. `rate` and `spans` are those of Ltc.
struct TakeTimecode {
  TimecodeSource source = TimecodeSource::None;
  TimecodeRate rate;
  std::vector<TimecodeSpan> spans;          ///< rising, none overlaps another
  std::int64_t utc_minus_monotonic_ns = 0;  ///< of Clock
};

/// A place in timecode.
struct TimecodePlace {
  std::int64_t count = 0;  ///< frames since 00:00:00:00
  int thousandths = 0;     ///< of the frame, 0 to 999
  TimecodeRate rate;
};

/// Where a time is. time_ns: CLOCK_MONOTONIC. clock_hz: frames a second of the labels of
/// TimecodeSource::Clock. Nothing where it is not known.
std::optional<TimecodePlace> timecode_at(const TakeTimecode& timecode, std::int64_t time_ns, double clock_hz);
/// The same, counted on from the nearest span where it is not known; nothing of TimecodeSource::None alone.
std::optional<TimecodePlace> timecode_near(const TakeTimecode& timecode, std::int64_t time_ns,
                                           double clock_hz);

/// "HH:MM:SS:FF"; with drop-frame counting "HH:MM:SS;FF".
std::string to_text(const TimecodePlace& place);

/// How a text of `meta` is named and what it says.
using MetaEntries = std::vector<std::pair<std::string, std::string>>;

/// As `meta` has it; spans that do not fit into kMostSpanTexts texts are left out, the last first.
MetaEntries to_meta(const TakeTimecode& timecode);
inline constexpr int kMostSpanTexts = 8;
/// Out of a take's `meta`, a file from outside: what is not sound is left out. text_of: a key's value, empty
/// where it is not there.
TakeTimecode timecode_of(const std::function<std::string(std::string_view key)>& text_of);

/// The sound beside a take: NAME.flac, whose samples are evenly spaced.
struct TakeSound {
  std::int64_t first_ns = 0;  ///< CLOCK_MONOTONIC, of its first sample; 0: the take has no sound
  double rate_hz = 0;         ///< samples a second of CLOCK_MONOTONIC, as measured
  int nominal_hz = 0;         ///< as the file says
  std::int64_t samples = 0;   ///< of each channel
  std::int64_t lost = 0;      ///< of these: silence in the place of samples that were lost
  std::string reason;         ///< empty, or why it ended before the take

  bool is_there() const { return first_ns != 0; }
};

/// NAME.flac of the take NAME.take.
std::filesystem::path sound_file_of(const std::filesystem::path& take);

MetaEntries to_meta(const TakeSound& sound);
TakeSound sound_of(const std::function<std::string(std::string_view key)>& text_of);

}  // namespace facet::take
