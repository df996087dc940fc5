#include "sound/timecode_follower.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <iterator>
#include <utility>

namespace facet::sound {
namespace {

constexpr std::array kNominal = {24, 25, 30};
/// A tape that is wound is none that tells the time.
constexpr double kSpeedTolerance = 0.02;
/// How far a frame may be beside its place, frames.
constexpr double kPlaceTolerance = 0.25;
/// How far the newest frames may be off the line, on average, frames.
constexpr double kWandering = 0.1;
constexpr std::size_t kMostSpans = 1000;

/// Nothing where the speed is none of timecode's.
std::optional<take::TimecodeRate> rate_of(const LtcFrame& frame, std::int64_t length_ns) {
  const double hz = 1e9 / static_cast<double>(length_ns);
  for (const int nominal : kNominal) {
    if (std::abs(hz / nominal - 1) < kSpeedTolerance) {
      const bool drop = frame.drop && nominal == 30;
      return take::TimecodeRate{nominal, drop, drop};
    }
  }
  return std::nullopt;
}

}  // namespace

void TimecodeFollower::Run::begin(const Heard& heard, const take::TimecodeRate& with_rate,
                                  int with_direction) {
  *this = {};
  rate = with_rate;
  direction = with_direction;
  first_ns = heard.first_ns;
  first_count = heard.count;
  add(heard);
}

double TimecodeFollower::Run::frames_to(std::int64_t time_ns) const {
  const take::TimecodeSpan line = span();
  return static_cast<double>(time_ns - line.first_ns) / std::abs(line.frame_ns);
}

bool TimecodeFollower::Run::goes_on_with(const Heard& heard) const {
  const Heard& last = newest.back();
  const double since = static_cast<double>(heard.first_ns - last.first_ns) / nominal_ns();
  const std::int64_t frames_on = std::llround(since);
  const std::int64_t day = rate.frames_a_day();
  const std::int64_t expected = ((last.count + direction * frames_on) % day + day) % day;
  return frames_on >= 1 && since * nominal_ns() <= static_cast<double>(kFlywheel_ns) &&
         heard.count == expected && std::abs(since - static_cast<double>(frames_on)) < kPlaceTolerance;
}

void TimecodeFollower::Run::add(const Heard& heard) {
  const std::int64_t since_ns = heard.first_ns - first_ns;
  const double number = static_cast<double>(
      newest.empty() ? 0 : std::llround(static_cast<double>(since_ns) / std::abs(span().frame_ns)));
  const double beside_ns = static_cast<double>(since_ns) - number * nominal_ns();
  ++frames;
  x += number;
  y += beside_ns;
  xx += number * number;
  xy += number * beside_ns;
  newest.push_back(heard);
  if (newest.size() > kFramesToLock) {
    newest.pop_front();
  }
}

take::TimecodeSpan TimecodeFollower::Run::span() const {
  const auto n = static_cast<double>(frames);
  const double spread = xx - x * x / n;
  const double slope_ns = frames >= kFramesToLock && spread > 0 ? (xy - x * y / n) / spread : 0;
  const double offset_ns = frames > 0 ? (y - slope_ns * x) / n : 0;
  const double frame_ns = nominal_ns() + slope_ns;
  take::TimecodeSpan span;
  span.first_ns = first_ns + std::llround(offset_ns);
  span.first_count = first_count;
  span.last_ns =
      newest.empty() ? span.first_ns : newest.back().first_ns + std::llround(frame_ns) + kFlywheel_ns;
  span.frame_ns = direction * frame_ns;
  return span;
}

void TimecodeFollower::add(const LtcFrame& frame, std::int64_t first_ns, std::int64_t end_ns) {
  const auto rate = rate_of(frame, end_ns - first_ns);
  if (!rate || first_ns <= 0) {
    return;
  }
  const Heard heard{first_ns, take::frame_count(frame.label, *rate)};
  const int direction = frame.backwards ? -1 : 1;
  const auto fits = [&](const std::optional<Run>& run) {
    return run && run->direction == direction && run->rate.nominal == rate->nominal &&
           run->rate.drop == rate->drop && run->goes_on_with(heard);
  };
  if (fits(run_)) {
    next_.reset();
    run_->add(heard);
    double beside = 0;
    for (const Heard& one : run_->newest) {
      const double number = run_->frames_to(one.first_ns);
      beside += (number - std::round(number)) / static_cast<double>(run_->newest.size());
    }
    if (std::abs(beside) > kWandering) {
      Run on;
      on.begin(run_->newest.front(), run_->rate, direction);
      std::for_each(run_->newest.begin() + 1, run_->newest.end(), [&](const Heard& one) { on.add(one); });
      lock(std::move(on));
    }
    return;
  }
  if (!fits(next_)) {
    Run begun;
    begun.begin(heard, *rate, direction);
    next_ = std::move(begun);
    return;
  }
  next_->add(heard);
  if (next_->frames >= kFramesToLock) {
    // 29.97 and 30, 23.976 and 24 differ in nothing but a thousandth of speed.
    const double hz = 1e9 / std::abs(next_->span().frame_ns);
    const double slower_hz = next_->rate.nominal * 1000.0 / 1001.0;
    Run run = *next_;
    run.rate.over_1001 = run.rate.nominal != 25 && std::abs(hz - slower_hz) < std::abs(hz - run.rate.nominal);
    run.rate.over_1001 = run.rate.over_1001 || run.rate.drop;
    Run anew;
    anew.begin(run.newest.front(), run.rate, direction);
    std::for_each(run.newest.begin() + 1, run.newest.end(), [&](const Heard& one) { anew.add(one); });
    next_.reset();
    lock(std::move(anew));
  }
}

/// The run that counted so far ends where this one begins.
void TimecodeFollower::lock(Run run) {
  if (run.rate != rate_) {
    ended_.clear();
    rate_ = run.rate;
  } else if (run_) {
    take::TimecodeSpan before = run_->span();
    before.last_ns = std::min(before.last_ns, run.span().first_ns);
    if (before.last_ns > before.first_ns) {
      ended_.push_back(before);
    }
    if (ended_.size() > kMostSpans) {
      ended_.erase(ended_.begin());
    }
  }
  run_ = std::move(run);
}

take::TakeTimecode TimecodeFollower::timecode(std::int64_t since_ns) const {
  take::TakeTimecode timecode;
  timecode.rate = rate_;
  std::copy_if(ended_.begin(), ended_.end(), std::back_inserter(timecode.spans),
               [&](const take::TimecodeSpan& span) { return span.last_ns >= since_ns; });
  if (run_ && run_->span().last_ns >= since_ns) {
    const take::TimecodeSpan now = run_->span();
    if (!timecode.spans.empty()) {
      // Where it begins is known better the longer it runs.
      take::TimecodeSpan& before = timecode.spans.back();
      before.last_ns = std::max(before.first_ns, std::min(before.last_ns, now.first_ns));
    }
    timecode.spans.push_back(now);
  }
  timecode.source = timecode.spans.empty() ? take::TimecodeSource::None : take::TimecodeSource::Ltc;
  return timecode;
}

}  // namespace facet::sound
