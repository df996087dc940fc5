#include "sound/alsa_source.hpp"

#include <alsa/asoundlib.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <mutex>

#include "facet/clock.hpp"
#include "facet/error.hpp"

namespace facet::sound {
namespace {

constexpr int kWait_ms = 100;
constexpr unsigned kPeriod_us = 10'000;
/// What the device keeps while this thread gets no processor.
constexpr unsigned kBuffer_us = 1'000'000;

struct Encoding {
  snd_pcm_format_t format;
  int bits;
};
/// Most bits first.
constexpr std::array<Encoding, 2> kEncodings = {{{SND_PCM_FORMAT_S32, 24}, {SND_PCM_FORMAT_S16, 16}}};

/// ALSA writes what goes wrong to standard error, where nobody looks.
void quiet(const char* /*file*/, int /*line*/, const char* /*function*/, int /*error*/,
           const char* /*format*/, ...) {}

void keep_quiet() {
  static std::once_flag once;
  std::call_once(once, [] { snd_lib_error_set_handler(quiet); });
}

struct ClosePcm {
  void operator()(snd_pcm_t* pcm) const { snd_pcm_close(pcm); }
};

std::int64_t ns_of(const snd_htimestamp_t& time) {
  return time.tv_sec * std::int64_t{1'000'000'000} + time.tv_nsec;
}

}  // namespace

struct AlsaSource::Impl {
  std::string device;
  int rate_hz;
  int channels;
  std::unique_ptr<snd_pcm_t, ClosePcm> pcm;
  int bits = 0;
  std::vector<std::int32_t> wide;   ///< [samples][channels] as the device has them
  std::vector<std::int16_t> small;  ///< likewise
  std::string fault;

  [[noreturn]] void fail(const char* what, int error) {
    pcm.reset();
    throw Error(ErrorKind::Unavailable,
                fmt::format("sound input \"{}\" {}: {}", device, what, snd_strerror(error)));
  }
  void require(int result, const char* what) {
    if (result < 0) {
      fail(what, result);
    }
  }
  SoundEvent gone(int error) {
    fault = fmt::format("sound input \"{}\" is gone: {}", device, snd_strerror(error));
    return SoundEvent::Gone;
  }
  void choose_format();
  void choose_times();
  SoundEvent recovered(int error, SoundBlock& block);
  snd_pcm_sframes_t read_into(SoundBlock& block, snd_pcm_uframes_t samples);
};

void AlsaSource::Impl::choose_format() {
  snd_pcm_hw_params_t* wanted = nullptr;
  snd_pcm_hw_params_alloca(&wanted);
  require(snd_pcm_hw_params_any(pcm.get(), wanted), "has no format");
  require(snd_pcm_hw_params_set_access(pcm.get(), wanted, SND_PCM_ACCESS_RW_INTERLEAVED), "can't be read");
  const auto encoding = std::find_if(kEncodings.begin(), kEncodings.end(), [&](const Encoding& one) {
    return snd_pcm_hw_params_set_format(pcm.get(), wanted, one.format) == 0;
  });
  if (encoding == kEncodings.end()) {
    fail("has neither 32 nor 16 bits (\"plughw:\" in place of \"hw:\" turns them)", -EINVAL);
  }
  bits = encoding->bits;
  require(snd_pcm_hw_params_set_channels(pcm.get(), wanted, static_cast<unsigned>(channels)),
          "has not so many channels (sound.channels)");
  require(snd_pcm_hw_params_set_rate(pcm.get(), wanted, static_cast<unsigned>(rate_hz), 0),
          "has no such rate (sound.rate_hz)");
  unsigned period_us = kPeriod_us;
  unsigned buffer_us = kBuffer_us;
  snd_pcm_hw_params_set_period_time_near(pcm.get(), wanted, &period_us, nullptr);
  snd_pcm_hw_params_set_buffer_time_near(pcm.get(), wanted, &buffer_us, nullptr);
  require(snd_pcm_hw_params(pcm.get(), wanted), "does not take its format");
}

/// Times of CLOCK_MONOTONIC, where the device has any.
void AlsaSource::Impl::choose_times() {
  snd_pcm_sw_params_t* wanted = nullptr;
  snd_pcm_sw_params_alloca(&wanted);
  require(snd_pcm_sw_params_current(pcm.get(), wanted), "can't be set up");
  snd_pcm_sw_params_set_tstamp_mode(pcm.get(), wanted, SND_PCM_TSTAMP_ENABLE);
  snd_pcm_sw_params_set_tstamp_type(pcm.get(), wanted, SND_PCM_TSTAMP_TYPE_MONOTONIC);
  require(snd_pcm_sw_params(pcm.get(), wanted), "can't be set up");
}

AlsaSource::AlsaSource(std::string device, int rate_hz, int channels) : impl_(std::make_unique<Impl>()) {
  impl_->device = std::move(device);
  impl_->rate_hz = rate_hz;
  impl_->channels = channels;
}

AlsaSource::~AlsaSource() = default;

SoundFormat AlsaSource::open() {
  keep_quiet();
  Impl& impl = *impl_;
  impl.pcm.reset();
  snd_pcm_t* opened = nullptr;
  impl.require(snd_pcm_open(&opened, impl.device.c_str(), SND_PCM_STREAM_CAPTURE, SND_PCM_NONBLOCK),
               "can't be opened");
  impl.pcm.reset(opened);
  impl.choose_format();
  impl.choose_times();
  impl.require(snd_pcm_prepare(opened), "can't be prepared");
  impl.require(snd_pcm_start(opened), "does not begin");
  return {impl.rate_hz, impl.channels, impl.bits};
}

/// After an overrun or a suspension; whatever else is wrong, the device is gone.
SoundEvent AlsaSource::Impl::recovered(int error, SoundBlock& block) {
  if (error != -EPIPE && error != -ESTRPIPE) {
    return gone(error);
  }
  block.lost_before = true;
  int result = snd_pcm_prepare(pcm.get());
  result = result == 0 ? snd_pcm_start(pcm.get()) : result;
  return result < 0 ? gone(result) : SoundEvent::Nothing;
}

snd_pcm_sframes_t AlsaSource::Impl::read_into(SoundBlock& block, snd_pcm_uframes_t samples) {
  const std::size_t values = samples * static_cast<std::size_t>(channels);
  snd_pcm_sframes_t got = 0;
  block.samples.resize(values);
  if (bits == 16) {
    small.resize(values);
    got = snd_pcm_readi(pcm.get(), small.data(), samples);
    std::transform(small.begin(), small.end(), block.samples.begin(),
                   [](std::int16_t value) { return std::int32_t{value} * (1 << (kSampleBits - 16)); });
  } else {
    wide.resize(values);
    got = snd_pcm_readi(pcm.get(), wide.data(), samples);
    std::transform(wide.begin(), wide.end(), block.samples.begin(),
                   [](std::int32_t value) { return value >> (32 - kSampleBits); });
  }
  block.samples.resize(static_cast<std::size_t>(std::max<snd_pcm_sframes_t>(got, 0)) *
                       static_cast<std::size_t>(channels));
  return got;
}

SoundEvent AlsaSource::read(SoundBlock& block) {
  Impl& impl = *impl_;
  block.samples.clear();
  block.lost_before = false;
  if (const int waited = snd_pcm_wait(impl.pcm.get(), kWait_ms); waited <= 0) {
    return waited == 0 ? SoundEvent::Nothing : impl.recovered(waited, block);
  }
  // First what it had when, then what it gives.
  snd_pcm_status_t* status = nullptr;
  snd_pcm_status_alloca(&status);
  if (const int result = snd_pcm_status(impl.pcm.get(), status); result < 0) {
    return impl.recovered(result, block);
  }
  const snd_pcm_uframes_t there = snd_pcm_status_get_avail(status);
  snd_htimestamp_t time{};
  snd_pcm_status_get_htstamp(status, &time);
  const auto most = static_cast<snd_pcm_uframes_t>(impl.rate_hz) / 10;
  const snd_pcm_sframes_t got = impl.read_into(block, std::clamp<snd_pcm_uframes_t>(there, 1, most));
  if (got == -EAGAIN) {
    return SoundEvent::Nothing;
  }
  if (got < 0) {
    return impl.recovered(static_cast<int>(got), block);
  }
  block.taken = std::max<std::int64_t>(static_cast<std::int64_t>(there), got);
  block.time_ns = ns_of(time) > 0 ? ns_of(time) : Clock::now_ns();
  return got > 0 ? SoundEvent::Samples : SoundEvent::Nothing;
}

std::string AlsaSource::reason() const {
  return impl_->fault;
}

void AlsaSource::close() {
  impl_->pcm.reset();
}

}  // namespace facet::sound
