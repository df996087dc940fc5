#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "facet/error.hpp"
#include "sound/sound_source.hpp"
#include "support/set_clock.hpp"

namespace facet::test {

/// What a virtual sound card does, shared with the test that has it in its hands.
struct CardScript {
  SetClock& clock;
  sound::SoundFormat format{48000, 1, 24};
  double drift_ppm = 0;       ///< of its clock to CLOCK_MONOTONIC
  std::int64_t begin_ns = 0;  ///< CLOCK_MONOTONIC of its sample 0
  double most_late_ms = 0.5;  ///< of what it says of its samples; one in fifty is ten times as late
  /// What a channel (from 0) hears at a sample of the card's clock, which counts on whatever becomes of the
  /// device; -1 to 1.
  std::function<double(std::int64_t sample, int channel)> wave = [](std::int64_t, int) { return 0.0; };
  std::atomic<std::int64_t> until_ns{0};  ///< where the clock stands still
  std::atomic<bool> plugged{true};
  std::atomic<std::int64_t> lose_samples{0};  ///< with the next read

  double rate_hz() const { return format.rate_hz * (1 + drift_ppm * 1e-6); }
  double sample_at(std::int64_t time_ns) const {
    return static_cast<double>(time_ns - begin_ns) * 1e-9 * rate_hz();
  }
  /// Lets time go on until then, and waits for it: all samples are read.
  void run_until(std::int64_t time_ns) {
    until_ns = time_ns;
    while (clock.now().time_since_epoch().count() < time_ns) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }
};

/// A sound card whose time goes on as fast as it is read, ten milliseconds a read.
class VirtualCard final : public sound::SoundSource {
 public:
  explicit VirtualCard(std::shared_ptr<CardScript> script) : script_(std::move(script)) {}

  sound::SoundFormat open() override {
    if (!script_->plugged) {
      throw Error(ErrorKind::Unavailable, "the virtual card is not plugged in");
    }
    next_ = std::llround(script_->sample_at(now_ns()));
    return script_->format;
  }
  sound::SoundEvent read(sound::SoundBlock& block) override {
    block.samples.clear();
    block.lost_before = false;
    if (!script_->plugged) {
      return sound::SoundEvent::Gone;
    }
    const std::int64_t before = now_ns();
    const std::int64_t now = std::min<std::int64_t>(before + 10'000'000, script_->until_ns);
    if (now <= before) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
      return sound::SoundEvent::Nothing;
    }
    if (const std::int64_t lost = script_->lose_samples.exchange(0); lost > 0) {
      next_ += lost;
      block.lost_before = true;
    }
    std::uniform_real_distribution<double> late(0, script_->most_late_ms);
    const double late_ms = late(random_) * (random_() % 50 == 0 ? 10 : 1);
    const auto end =
        static_cast<std::int64_t>(script_->sample_at(now - static_cast<std::int64_t>(late_ms * 1e6)));
    for (std::int64_t sample = next_; sample < end; ++sample) {
      for (int channel = 0; channel < script_->format.channels; ++channel) {
        block.samples.push_back(
            static_cast<std::int32_t>(std::lround(script_->wave(sample, channel) * (sound::kFullScale - 1))));
      }
    }
    block.taken = std::max<std::int64_t>(end - next_, 0);
    next_ = std::max(next_, end);
    block.time_ns = now;
    script_->clock.set(now);
    return block.samples.empty() ? sound::SoundEvent::Nothing : sound::SoundEvent::Samples;
  }
  std::string reason() const override { return "the virtual card was pulled out"; }
  void close() override {}

 private:
  std::int64_t now_ns() const { return script_->clock.now().time_since_epoch().count(); }

  std::shared_ptr<CardScript> script_;
  std::int64_t next_ = 0;
  std::mt19937 random_{7};  ///< the same in every run
};

}  // namespace facet::test
