#include "service/sound_desk.hpp"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "sound/alsa_source.hpp"

namespace facet::service {
namespace {

using nlohmann::json;

/// Before a take's first frame: as long as sound is kept, frames come later than they were seen.
constexpr std::int64_t kBefore_ns = 2'000'000'000;
constexpr double kClockRate_hz = 30;
constexpr std::chrono::seconds kSettled{1};

std::int64_t utc_minus_monotonic_ns() {
  const auto utc = std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::utc().time_since_epoch());
  return utc.count() - Clock::now_ns();
}

take::TakeTimecode of_day(std::int64_t utc_minus_monotonic) {
  take::TakeTimecode timecode;
  timecode.source = take::TimecodeSource::Clock;
  timecode.utc_minus_monotonic_ns = utc_minus_monotonic;
  return timecode;
}

}  // namespace

SoundDesk::SoundDesk(const sound::SoundConfig& config, const Log& log,
                     std::unique_ptr<sound::SoundSource> source)
    : log_(log), device_(config.device) {
  if (source == nullptr && !config.device.empty()) {
    source = std::make_unique<sound::AlsaSource>(config.device, config.rate_hz, config.channels);
  }
  if (source != nullptr) {
    capture_.emplace(config, std::move(source));
  }
}

SoundDesk::~SoundDesk() = default;

void SoundDesk::start() {
  if (capture_) {
    capture_->start();
  }
}

void SoundDesk::look_after() {
  if (!capture_) {
    return;
  }
  const sound::SoundStatus now = capture_->status();
  const auto time = Clock::now();
  if (now.state != seen_ || now.reason != seen_reason_) {
    seen_ = now.state;
    seen_reason_ = now.reason;
    seen_since_ = time;
  }
  // One that opens and ends at once, again and again, is told once.
  if (time - seen_since_ < kSettled || (now.state == told_state_ && now.reason == told_reason_)) {
    return;
  }
  told_state_ = now.state;
  told_reason_ = now.reason;
  const Log::Fields fields = {{"FACET_EVENT", "sound"}};
  if (now.state == sound::SoundState::Absent) {
    log_.warning(fmt::format("{}; it is looked for every 2 s", now.reason), fields);
  } else if (now.state == sound::SoundState::Running) {
    log_.info(fmt::format("sound input \"{}\" runs", device_), fields);
  }
}

void SoundDesk::request_stop() {
  if (capture_) {
    capture_->request_stop();
  }
}

bool SoundDesk::finished() const {
  return !capture_ || capture_->finished();
}

void SoundDesk::stop() {
  if (capture_) {
    capture_->stop();
  }
}

/// LTC where it was heard, else the time of day.
take::MetaEntries SoundDesk::beside(std::int64_t begun_ns, std::int64_t utc_minus_monotonic) const {
  take::TakeTimecode timecode;
  if (capture_) {
    timecode = capture_->timecode(begun_ns - kBefore_ns);
  }
  if (timecode.source == take::TimecodeSource::None) {
    timecode = of_day(utc_minus_monotonic);
  }
  take::MetaEntries entries = take::to_meta(timecode);
  if (capture_) {
    const take::TakeSound sound = capture_->take_sound();
    if (sound.is_there() || !sound.reason.empty()) {
      const take::MetaEntries more = take::to_meta(sound);
      entries.insert(entries.end(), more.begin(), more.end());
    }
  }
  return entries;
}

void SoundDesk::begin(take::TakeRecorderConfig& take) {
  if (take.when_full == take::WhenFull::Wait) {
    return;  // recorded footage: it is of another time
  }
  take.more_meta = [this, before = std::exchange(take.more_meta, nullptr), begun_ns = Clock::now_ns(),
                    utc_minus_monotonic = utc_minus_monotonic_ns()] {
    take::MetaEntries entries = before ? before() : take::MetaEntries();
    const take::MetaEntries more = beside(begun_ns, utc_minus_monotonic);
    entries.insert(entries.end(), more.begin(), more.end());
    return entries;
  };
  if (!capture_) {
    return;
  }
  try {
    const std::filesystem::path file = take::sound_file_of(take.file);
    if (capture_->begin_take(file, take.disk_reserve_bytes)) {
      file_ = file;
    }
  } catch (const Error& error) {
    log_.warning(fmt::format("take {} has no sound: {}", take.file.string(), error.what()),
                 {{"FACET_EVENT", "sound"}, {"FACET_TAKE", take.file.string()}});
  }
}

void SoundDesk::request_end() {
  if (capture_) {
    capture_->request_take_end();
  }
}

void SoundDesk::end() {
  if (!capture_ || !file_) {
    return;
  }
  const take::TakeSound sound = capture_->end_take();
  const std::string text =
      fmt::format("sound {}: {:.1f} s, {} samples lost", file_->string(),
                  static_cast<double>(sound.samples) / std::max(1, sound.nominal_hz), sound.lost);
  file_.reset();
  if (sound.reason.empty()) {
    log_.info(text, {{"FACET_EVENT", "sound"}});
  } else {
    log_.warning(fmt::format("{}; it ended before the take: {}", text, sound.reason),
                 {{"FACET_EVENT", "sound"}});
  }
}

void SoundDesk::cancel() {
  if (!capture_ || !file_) {
    return;
  }
  capture_->end_take();
  std::error_code ignored;
  std::filesystem::remove(*file_, ignored);
  file_.reset();
}

std::string SoundDesk::timecode_now() const {
  const std::int64_t now_ns = Clock::now_ns();
  const auto at = [&](const take::TakeTimecode& timecode) {
    const auto place = take::timecode_at(timecode, now_ns, kClockRate_hz);
    return place ? take::to_text(*place) : std::string();
  };
  const std::string heard = capture_ ? at(capture_->status().timecode) : std::string();
  return heard.empty() ? at(of_day(utc_minus_monotonic_ns())) : heard;
}

json SoundDesk::status() const {
  if (!capture_) {
    return nullptr;
  }
  const sound::SoundStatus now = capture_->status();
  const auto heard = take::timecode_at(now.timecode, Clock::now_ns(), kClockRate_hz);
  json timecode = nullptr;
  if (heard) {
    timecode = {{"now", take::to_text(*heard)}, {"rate", take::to_text(now.timecode.rate)}};
  }
  return {{"device", device_},      {"state", sound::to_string(now.state)}, {"reason", now.reason},
          {"rate_hz", now.rate_hz}, {"peak_dbfs", now.peak_dbfs},           {"breaks", now.breaks},
          {"lost", now.lost},       {"timecode", std::move(timecode)}};
}

}  // namespace facet::service
