#include "take/take_time.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <utility>

#include "take/take_file.hpp"

namespace facet::take {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kSeconds_a_day = 86'400;
constexpr std::int64_t kMinutes_a_day = 1440;
constexpr std::int64_t kDropped = 2;  ///< numbers a minute, but for every tenth
constexpr int kMostRate_hz = 240;
/// A take's time that is farther from its spans is none of ours.
constexpr double kMostFrames = 1e12;

std::int64_t wrapped(std::int64_t count, std::int64_t day) {
  const std::int64_t rest = count % day;
  return rest < 0 ? rest + day : rest;
}

/// frames: since the beginning of frame `first`, by the time.
TimecodePlace place_of(double frames, std::int64_t first, bool backwards, const TimecodeRate& rate) {
  const double bounded = std::clamp(frames, -kMostFrames, kMostFrames);
  // Times are whole nanoseconds: what lacks a ten-thousandth of a thousandth is there.
  const double in_thousandths = std::floor(bounded * 1000 + 1e-4);
  const double whole = std::floor(in_thousandths / 1000);
  const auto on = static_cast<std::int64_t>(whole);
  const int thousandths = static_cast<int>(in_thousandths - whole * 1000);
  return {wrapped(backwards ? first - on : first + on, rate.frames_a_day()),
          backwards ? 999 - thousandths : thousandths, rate};
}

/// Takes the next number off a text of numbers apart by blanks.
template <typename Number>
bool next_number(std::string_view& text, Number& out) {
  text.remove_prefix(std::min(text.find_first_not_of(' '), text.size()));
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), out);
  if (error != std::errc()) {
    return false;
  }
  text.remove_prefix(static_cast<std::size_t>(end - text.data()));
  return true;
}

template <typename Number>
Number number_of(const std::string& text, Number least, Number most) {
  std::string_view rest = text;
  Number number{};
  return next_number(rest, number) && rest.empty() && number >= least && number <= most ? number : Number{};
}

std::string spans_key(int text) {
  return text == 0 ? "timecode_spans" : fmt::format("timecode_spans_{}", text + 1);
}

bool is_sound(const TimecodeSpan& span, const TakeTimecode& timecode) {
  const double frame_ns = std::abs(span.frame_ns);
  return span.first_ns >= 0 && span.last_ns >= span.first_ns && span.first_count >= 0 &&
         span.first_count < timecode.rate.frames_a_day() && frame_ns >= 1e6 && frame_ns <= 2e9 &&
         (timecode.spans.empty() || span.first_ns >= timecode.spans.back().last_ns);
}

}  // namespace

std::int64_t TimecodeRate::frames_a_day() const {
  return kSeconds_a_day * nominal - (drop ? kDropped * (kMinutes_a_day - kMinutes_a_day / 10) : 0);
}

std::string to_text(const TimecodeRate& rate) {
  if (!rate.over_1001) {
    return std::to_string(rate.nominal);
  }
  return fmt::format("{:.{}f}{}", rate.hz(), rate.nominal % 30 == 0 ? 2 : 3, rate.drop ? " drop" : "");
}

std::optional<TimecodeRate> timecode_rate(std::string_view text) {
  for (int nominal = 1; nominal <= kMostRate_hz; ++nominal) {
    for (const TimecodeRate& rate : {TimecodeRate{nominal, false, false}, TimecodeRate{nominal, true, false},
                                     TimecodeRate{nominal, true, true}}) {
      if ((!rate.drop || nominal == 30) && to_text(rate) == text) {
        return rate;
      }
    }
  }
  return std::nullopt;
}

std::int64_t frame_count(const TimecodeLabel& label, const TimecodeRate& rate) {
  const std::int64_t minutes = label.hours * std::int64_t{60} + label.minutes;
  std::int64_t count = (minutes * 60 + label.seconds) * rate.nominal + label.frames;
  if (rate.drop) {
    const bool left_out = label.seconds == 0 && label.frames < kDropped && label.minutes % 10 != 0;
    count += left_out ? kDropped - label.frames : 0;
    count -= kDropped * (minutes - minutes / 10);
  }
  return wrapped(count, rate.frames_a_day());
}

TimecodeLabel timecode_label(std::int64_t frame_count, const TimecodeRate& rate) {
  std::int64_t number = wrapped(frame_count, rate.frames_a_day());
  if (rate.drop) {
    const std::int64_t a_minute = std::int64_t{60} * rate.nominal - kDropped;
    const std::int64_t ten_minutes = 10 * a_minute + kDropped;
    const std::int64_t within = number % ten_minutes;
    number += 9 * kDropped * (number / ten_minutes);
    number += within >= a_minute + kDropped ? kDropped * ((within - kDropped) / a_minute) : 0;
  }
  const std::int64_t seconds = number / rate.nominal;
  return {static_cast<int>(seconds / 3600), static_cast<int>(seconds / 60 % 60),
          static_cast<int>(seconds % 60), static_cast<int>(number % rate.nominal)};
}

const char* to_string(TimecodeSource source) {
  switch (source) {
    case TimecodeSource::None:
      return "none";
    case TimecodeSource::Clock:
      return "clock";
    case TimecodeSource::Ltc:
      return "ltc";
  }
  return "unknown";
}

std::optional<TimecodePlace> timecode_near(const TakeTimecode& timecode, std::int64_t time_ns,
                                           double clock_hz) {
  if (timecode.source == TimecodeSource::Clock) {
    const TimecodeRate rate{static_cast<int>(std::clamp(std::lround(clock_hz), 1L, long{kMostRate_hz})),
                            false, false};
    const std::int64_t of_day =
        wrapped(wrapped(time_ns, kSeconds_a_day * kSecond_ns) +
                    wrapped(timecode.utc_minus_monotonic_ns, kSeconds_a_day * kSecond_ns),
                kSeconds_a_day * kSecond_ns);
    return place_of(static_cast<double>(of_day) * 1e-9 * rate.nominal, 0, false, rate);
  }
  const TimecodeSpan* nearest = nullptr;
  double distance = std::numeric_limits<double>::max();
  for (const TimecodeSpan& span : timecode.spans) {
    const auto time = static_cast<double>(time_ns);
    const double away =
        std::max({static_cast<double>(span.first_ns) - time, time - static_cast<double>(span.last_ns), 0.0});
    // Where two meet, the later begins.
    if (away <= distance) {
      distance = away;
      nearest = &span;
    }
  }
  if (nearest == nullptr) {
    return std::nullopt;
  }
  const double since_ns = static_cast<double>(time_ns) - static_cast<double>(nearest->first_ns);
  return place_of(since_ns / std::abs(nearest->frame_ns), nearest->first_count, nearest->frame_ns < 0,
                  timecode.rate);
}

std::optional<TimecodePlace> timecode_at(const TakeTimecode& timecode, std::int64_t time_ns,
                                         double clock_hz) {
  const bool known = timecode.source == TimecodeSource::Clock ||
                     std::any_of(timecode.spans.begin(), timecode.spans.end(), [&](const TimecodeSpan& span) {
                       return time_ns >= span.first_ns && time_ns <= span.last_ns;
                     });
  return known ? timecode_near(timecode, time_ns, clock_hz) : std::nullopt;
}

std::string to_text(const TimecodePlace& place) {
  const TimecodeLabel label = timecode_label(place.count, place.rate);
  return fmt::format("{:02}:{:02}:{:02}{}{:02}", label.hours, label.minutes, label.seconds,
                     place.rate.drop ? ';' : ':', label.frames);
}

MetaEntries to_meta(const TakeTimecode& timecode) {
  MetaEntries entries = {{"timecode_source", to_string(timecode.source)}};
  if (timecode.source == TimecodeSource::Clock) {
    entries.emplace_back("timecode_utc_minus_monotonic_ns", std::to_string(timecode.utc_minus_monotonic_ns));
  }
  if (timecode.source != TimecodeSource::Ltc) {
    return entries;
  }
  entries.emplace_back("timecode_rate", to_text(timecode.rate));
  int texts = 0;
  std::string text;
  for (const TimecodeSpan& span : timecode.spans) {
    const std::string one =
        fmt::format("{} {} {} {:.3f};", span.first_ns, span.last_ns, span.first_count, span.frame_ns);
    if (text.size() + one.size() > kMaxMetaBytes) {
      entries.emplace_back(spans_key(texts), std::exchange(text, {}));
      if (++texts == kMostSpanTexts) {
        return entries;
      }
    }
    text += one;
  }
  entries.emplace_back(spans_key(texts), text);
  return entries;
}

TakeTimecode timecode_of(const std::function<std::string(std::string_view key)>& text_of) {
  TakeTimecode timecode;
  const std::string source = text_of("timecode_source");
  if (source == to_string(TimecodeSource::Clock)) {
    timecode.source = TimecodeSource::Clock;
    timecode.utc_minus_monotonic_ns = number_of<std::int64_t>(text_of("timecode_utc_minus_monotonic_ns"),
                                                              std::numeric_limits<std::int64_t>::min() / 2,
                                                              std::numeric_limits<std::int64_t>::max() / 2);
    return timecode;
  }
  const auto rate = timecode_rate(text_of("timecode_rate"));
  if (source != to_string(TimecodeSource::Ltc) || !rate) {
    return timecode;
  }
  timecode.source = TimecodeSource::Ltc;
  timecode.rate = *rate;
  for (int number = 0; number < kMostSpanTexts; ++number) {
    const std::string text = text_of(spans_key(number));
    std::string_view rest = text;
    TimecodeSpan span;
    while (next_number(rest, span.first_ns) && next_number(rest, span.last_ns) &&
           next_number(rest, span.first_count) && next_number(rest, span.frame_ns) && rest.starts_with(';')) {
      rest.remove_prefix(1);
      if (!is_sound(span, timecode)) {
        return timecode;
      }
      timecode.spans.push_back(span);
    }
  }
  return timecode;
}

std::filesystem::path sound_file_of(const std::filesystem::path& take) {
  return std::filesystem::path(take).replace_extension(".flac");
}

MetaEntries to_meta(const TakeSound& sound) {
  if (!sound.is_there()) {
    return {{"sound_reason", cut_text(sound.reason, kMaxShownBytes)}};
  }
  return {{"sound_first_ns", std::to_string(sound.first_ns)},
          {"sound_rate_hz", fmt::format("{:.6f}", sound.rate_hz)},
          {"sound_nominal_hz", std::to_string(sound.nominal_hz)},
          {"sound_samples", std::to_string(sound.samples)},
          {"sound_lost", std::to_string(sound.lost)},
          {"sound_reason", cut_text(sound.reason, kMaxShownBytes)}};
}

TakeSound sound_of(const std::function<std::string(std::string_view key)>& text_of) {
  constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max() / 2;
  TakeSound sound;
  sound.reason = cut_text(text_of("sound_reason"), kMaxShownBytes);
  sound.rate_hz = number_of(text_of("sound_rate_hz"), 1000.0, 1e6);
  sound.nominal_hz = number_of(text_of("sound_nominal_hz"), 1000, 1'000'000);
  if (sound.rate_hz == 0 || sound.nominal_hz == 0) {
    return sound;
  }
  sound.first_ns = number_of<std::int64_t>(text_of("sound_first_ns"), 1, kMost);
  sound.samples = number_of<std::int64_t>(text_of("sound_samples"), 0, kMost);
  sound.lost = number_of<std::int64_t>(text_of("sound_lost"), 0, kMost);
  return sound;
}

}  // namespace facet::take
