#include "sound/capture.hpp"

#include <fmt/format.h>
#include <pthread.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <deque>
#include <exception>
#include <optional>
#include <thread>
#include <utility>

#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "facet/mutex.hpp"
#include "sound/ltc_reader.hpp"
#include "sound/sound_clock.hpp"
#include "sound/sound_file.hpp"
#include "sound/timecode_follower.hpp"

namespace facet::sound {
namespace {

constexpr auto kLookPeriod = std::chrono::seconds(2);
constexpr auto kSilentDevice = std::chrono::seconds(2);
/// Sound before a take's beginning: frames come later than they were seen.
constexpr std::int64_t kKept_s = 2;
constexpr std::int64_t kLongestGap_s = 600;
/// From then on a take's first sample has its time; before, that gets better with the clock.
constexpr std::int64_t kSureAfter_s = 10;
constexpr std::int64_t kStatusSpan_ns = 4'000'000'000;
/// A device that gives samples so much faster than its rate has no clock of sound.
constexpr double kTooFast = 1.1;
constexpr double kHaste_s = 2;
constexpr double kSilence_dbfs = -200;

}  // namespace

const char* to_string(SoundState state) {
  switch (state) {
    case SoundState::Off:
      return "off";
    case SoundState::Absent:
      return "absent";
    case SoundState::Running:
      return "running";
  }
  return "unknown";
}

struct SoundCapture::Impl {
  Impl(const SoundConfig& given, std::unique_ptr<SoundSource> from)
      : config(given), source(std::move(from)), clock(given.rate_hz) {
    if (config.timecode_channel > 0) {
      ltc.emplace(config.rate_hz);
    }
  }

  /// Samples that are recorded, as they came.
  struct Kept {
    std::int64_t first = 0;
    std::vector<std::int32_t> samples;  ///< [sample_count][recorded channels]
  };
  struct Take {
    std::unique_ptr<SoundFile> file;
    std::int64_t first = 0;  ///< number of its first sample
    std::int64_t first_ns = 0;
    SoundFormat format;
  };

  const SoundConfig config;
  std::unique_ptr<SoundSource> source;  ///< facet-sound only

  mutable Mutex mutex;  ///< held for copies and sums alone
  Condition woken;
  bool stopping FACET_GUARDED_BY(mutex) = false;
  SoundStatus shown FACET_GUARDED_BY(mutex);
  SoundFormat format FACET_GUARDED_BY(mutex);
  SoundClock clock FACET_GUARDED_BY(mutex);
  std::optional<LtcReader> ltc FACET_GUARDED_BY(mutex);
  TimecodeFollower follower FACET_GUARDED_BY(mutex);
  std::vector<LtcFrame> heard FACET_GUARDED_BY(mutex);
  std::vector<std::int32_t> channel FACET_GUARDED_BY(mutex);
  std::int64_t next FACET_GUARDED_BY(mutex) = 0;  ///< number of the sample that comes next
  std::deque<Kept> kept FACET_GUARDED_BY(mutex);
  std::array<std::int32_t, 2> peaks FACET_GUARDED_BY(mutex){};  ///< of this second and the one before
  std::int64_t peak_second FACET_GUARDED_BY(mutex) = 0;
  std::optional<Take> take FACET_GUARDED_BY(mutex);
  take::TakeSound last_take FACET_GUARDED_BY(mutex);
  std::atomic<bool> ended{true};
  std::jthread thread;

  bool is_recorded(int index) const { return config.channels == 1 || index + 1 != config.timecode_channel; }
  int recorded_channels() const {
    return config.channels - (config.channels > 1 && config.timecode_channel > 0 ? 1 : 0);
  }

  void run();
  bool wait_for_device();
  void use_device();
  void lose(const std::string& reason);
  void take_in(const SoundBlock& block, bool broken);
  void bridge_gap(const SoundBlock& block) FACET_REQUIRES(mutex);
  void keep(const SoundBlock& block) FACET_REQUIRES(mutex);
  void follow(const SoundBlock& block) FACET_REQUIRES(mutex);
  take::TakeSound sound_so_far() FACET_REQUIRES(mutex);
};

/// False at the end.
bool SoundCapture::Impl::wait_for_device() {
  while (true) {
    try {
      const SoundFormat found = source->open();
      const Lock lock(mutex);
      if (take && found != format) {
        take->file->request_stop("the sound input came back with another format");
      }
      format = found;
      shown.state = SoundState::Running;
      shown.reason.clear();
      return !stopping;
    } catch (const Error& error) {
      const Lock lock(mutex);
      shown.state = SoundState::Absent;
      shown.reason = error.what();
      if (woken.wait_for(mutex, kLookPeriod, [this]() FACET_REQUIRES(mutex) { return stopping; })) {
        return false;
      }
    }
  }
}

void SoundCapture::Impl::lose(const std::string& reason) {
  source->close();
  const Lock lock(mutex);
  shown.state = SoundState::Absent;
  shown.reason = reason;
  woken.wait_for(mutex, kLookPeriod, [this]() FACET_REQUIRES(mutex) { return stopping; });
}

/// Until the device is gone, or the end.
void SoundCapture::Impl::use_device() {
  SoundBlock block;
  bool broken = true;  // also what it had before it came back
  auto last = Clock::now();
  const auto opened = last;
  double given_s = 0;
  while (true) {
    {
      const Lock lock(mutex);
      if (stopping) {
        return;
      }
    }
    const SoundEvent event = source->read(block);
    broken = broken || block.lost_before;
    const auto now = Clock::now();
    if (event == SoundEvent::Gone) {
      lose(source->reason());
      return;
    }
    if (event == SoundEvent::Nothing) {
      if (now - last > kSilentDevice) {
        lose(fmt::format("sound input \"{}\" gives no samples", config.device));
        return;
      }
      continue;
    }
    last = now;
    given_s += static_cast<double>(block.samples.size()) / config.channels / config.rate_hz;
    if (given_s > kTooFast * std::chrono::duration<double>(now - opened).count() + kHaste_s) {
      lose(fmt::format("sound input \"{}\" has no clock: it gives samples faster than {} Hz", config.device,
                       config.rate_hz));
      return;
    }
    take_in(block, std::exchange(broken, false));
  }
}

/// Silence for what was lost, by the clock that was measured before.
void SoundCapture::Impl::bridge_gap(const SoundBlock& block) {
  if (clock.empty()) {
    return;
  }
  const double now = clock.sample_at(block.time_ns);
  const auto lost = static_cast<std::int64_t>(std::llround(now)) - block.taken - next;
  ++shown.breaks;
  if (lost <= 0) {
    return;
  }
  if (lost > kLongestGap_s * config.rate_hz) {
    clock.restart();
    kept.clear();
    if (take) {
      take->file->request_stop("the sound input was away for over ten minutes");
    }
  } else {
    shown.lost += lost;
    if (take) {
      take->file->add_silence(lost);
      last_take.lost += lost;
    }
  }
  next += lost;
}

void SoundCapture::Impl::keep(const SoundBlock& block) {
  const auto channels = static_cast<std::size_t>(config.channels);
  Kept now{next, {}};
  now.samples.reserve(block.samples.size());
  std::int32_t peak = 0;
  for (std::size_t i = 0; i < block.samples.size(); ++i) {
    if (is_recorded(static_cast<int>(i % channels))) {
      now.samples.push_back(block.samples[i]);
      peak = std::max(peak, std::abs(block.samples[i]));
    }
  }
  if (const std::int64_t second = next / config.rate_hz; second != peak_second) {
    peaks = {0, second == peak_second + 1 ? peaks[0] : 0};
    peak_second = second;
  }
  peaks[0] = std::max(peaks[0], peak);
  const std::int32_t loudest = std::max(peaks[0], peaks[1]);
  shown.peak_dbfs = loudest > 0 ? 20 * std::log10(loudest / kFullScale) : kSilence_dbfs;
  if (!config.record) {
    return;
  }
  if (take) {
    take->file->add(now.samples);
  }
  while (!kept.empty() && kept.front().first < next - kKept_s * config.rate_hz) {
    kept.pop_front();
  }
  kept.push_back(std::move(now));
}

void SoundCapture::Impl::follow(const SoundBlock& block) {
  if (!ltc) {
    return;
  }
  const auto channels = static_cast<std::size_t>(config.channels);
  channel.clear();
  for (std::size_t i = static_cast<std::size_t>(config.timecode_channel) - 1; i < block.samples.size();
       i += channels) {
    channel.push_back(block.samples[i]);
  }
  heard.clear();
  ltc->read(channel, next, heard);
  for (const LtcFrame& frame : heard) {
    follower.add(frame, clock.time_of(static_cast<double>(frame.first_sample)),
                 clock.time_of(static_cast<double>(frame.end_sample)));
  }
}

void SoundCapture::Impl::take_in(const SoundBlock& block, bool broken) {
  const Lock lock(mutex);
  if (broken) {
    bridge_gap(block);
  }
  clock.add(next + block.taken, block.time_ns);
  shown.rate_hz = clock.settled() ? clock.rate_hz() : 0;
  keep(block);
  follow(block);
  next += static_cast<std::int64_t>(block.samples.size()) / config.channels;
}

void SoundCapture::Impl::run() {
  ::pthread_setname_np(::pthread_self(), "facet-sound");
  try {
    while (wait_for_device()) {
      use_device();
    }
  } catch (const std::exception& error) {
    const Lock lock(mutex);
    shown.state = SoundState::Absent;
    shown.reason = fmt::format("sound is given up: {}", error.what());
  }
  source->close();
  ended = true;
}

take::TakeSound SoundCapture::Impl::sound_so_far() {
  take::TakeSound sound = last_take;
  if (!take) {
    return sound;
  }
  const SoundFileStatus file = take->file->status();
  sound.samples = file.samples;
  sound.reason = file.reason;
  sound.lost = last_take.lost + file.lost;
  if (!clock.empty() && file.reason.empty()) {
    const auto first = static_cast<double>(take->first);
    const auto end = static_cast<double>(take->first + file.samples);
    if (file.samples < kSureAfter_s * config.rate_hz) {
      take->first_ns = clock.time_of(first);
      sound.rate_hz = clock.rate_hz();
    } else {
      sound.rate_hz =
          static_cast<double>(file.samples) * 1e9 / static_cast<double>(clock.time_of(end) - take->first_ns);
    }
  }
  sound.first_ns = take->first_ns;
  last_take.rate_hz = sound.rate_hz;
  return sound;
}

SoundCapture::SoundCapture(const SoundConfig& config, std::unique_ptr<SoundSource> source)
    : impl_(std::make_unique<Impl>(config, std::move(source))) {}

SoundCapture::~SoundCapture() {
  stop();
}

void SoundCapture::start() {
  impl_->ended = false;
  try {
    impl_->thread = std::jthread([this] { impl_->run(); });
  } catch (...) {
    impl_->ended = true;
    throw;
  }
}

void SoundCapture::request_stop() {
  const Lock lock(impl_->mutex);
  impl_->stopping = true;
  if (impl_->take) {
    impl_->take->file->request_stop();
  }
  impl_->woken.notify_all();
}

bool SoundCapture::finished() const {
  const Lock lock(impl_->mutex);
  return impl_->ended && (!impl_->take || impl_->take->file->ended());
}

void SoundCapture::stop() {
  request_stop();
  if (impl_->thread.joinable()) {
    impl_->thread.join();
  }
  end_take();
}

SoundStatus SoundCapture::status() const {
  const Lock lock(impl_->mutex);
  SoundStatus status = impl_->shown;
  status.timecode = impl_->follower.timecode(Clock::now_ns() - kStatusSpan_ns);
  return status;
}

take::TakeTimecode SoundCapture::timecode(std::int64_t since_ns) const {
  const Lock lock(impl_->mutex);
  return impl_->follower.timecode(since_ns);
}

bool SoundCapture::begin_take(const std::filesystem::path& file, std::uint64_t disk_reserve_bytes) {
  end_take();
  if (!impl_->config.record) {
    return false;
  }
  SoundFileConfig sound;
  sound.file = file;
  sound.disk_reserve_bytes = disk_reserve_bytes;
  {
    const Lock lock(impl_->mutex);
    impl_->last_take = {};
    if (impl_->shown.state != SoundState::Running || impl_->kept.empty()) {
      impl_->last_take.reason =
          impl_->shown.reason.empty() ? "there is no sound yet" : "there is no sound: " + impl_->shown.reason;
      throw Error(ErrorKind::Unavailable, impl_->last_take.reason);
    }
    sound.format = impl_->format;
    sound.format.channels = impl_->recorded_channels();
  }
  Impl::Take begun;
  try {
    begun.file = std::make_unique<SoundFile>(sound);
    begun.file->start();
  } catch (const std::exception& error) {
    const Lock lock(impl_->mutex);
    impl_->last_take.reason = error.what();
    throw Error(ErrorKind::Storage, error.what());
  }
  const Lock lock(impl_->mutex);
  if (impl_->kept.empty()) {
    begun.file->request_stop("the sound input was away for over ten minutes");
  }
  begun.format = sound.format;
  begun.first = impl_->kept.empty() ? impl_->next : impl_->kept.front().first;
  begun.first_ns = impl_->clock.time_of(static_cast<double>(begun.first));
  std::int64_t expected = begun.first;
  const auto channels = static_cast<std::size_t>(sound.format.channels);
  for (const Impl::Kept& kept : impl_->kept) {
    begun.file->add_silence(kept.first - expected);
    begun.file->add(kept.samples);
    expected = kept.first + static_cast<std::int64_t>(kept.samples.size() / channels);
  }
  impl_->last_take.nominal_hz = sound.format.rate_hz;
  impl_->take = std::move(begun);
  return true;
}

take::TakeSound SoundCapture::take_sound() const {
  const Lock lock(impl_->mutex);
  return impl_->sound_so_far();
}

void SoundCapture::request_take_end() {
  const Lock lock(impl_->mutex);
  if (impl_->take) {
    impl_->take->file->request_stop();
  }
}

take::TakeSound SoundCapture::end_take() {
  std::optional<Impl::Take> take;
  {
    const Lock lock(impl_->mutex);
    if (!impl_->take) {
      return impl_->last_take;
    }
    impl_->last_take = impl_->sound_so_far();
    take.swap(impl_->take);
  }
  const SoundFileStatus file = take->file->stop();
  const Lock lock(impl_->mutex);
  impl_->last_take.samples = file.samples;
  impl_->last_take.reason = file.reason;
  return impl_->last_take;
}

}  // namespace facet::sound
