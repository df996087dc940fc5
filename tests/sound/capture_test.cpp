// Sound of a virtual card whose clock drifts, beside frames whose times are known: what lies where.

#include "sound/capture.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "facet/error.hpp"
#include "sound/flac_file.hpp"
#include "sound/sound_clock.hpp"
#include "sound/sound_export.hpp"
#include "support/eventually.hpp"
#include "support/ltc_tape.hpp"
#include "support/paths.hpp"
#include "support/virtual_card.hpp"

namespace facet::sound {
namespace {

using test::CardScript;
using testing::HasSubstr;

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kBegin_ns = 7'000 * kSecond_ns;

/// A tone of 5 ms that begins at each of these times.
struct Bursts {
  std::vector<std::int64_t> times_ns;
  static constexpr std::int64_t kLength_ns = 5'000'000;

  double at(std::int64_t time_ns) const {
    const auto next = std::upper_bound(times_ns.begin(), times_ns.end(), time_ns);
    const std::int64_t since_ns = next == times_ns.begin() ? kLength_ns : time_ns - *(next - 1);
    return since_ns < kLength_ns
               ? 0.5 * std::sin(2 * std::numbers::pi * 2000 * static_cast<double>(since_ns) * 1e-9)
               : 0;
  }
};

std::vector<double> first_channel(const std::filesystem::path& file) {
  FlacReader reader(file);
  FlacReader::Block block;
  std::vector<double> out;
  while (reader.next(block)) {
    for (std::size_t i = 0; i < block.samples.size();
         i += static_cast<std::size_t>(reader.format().channels)) {
      out.push_back(block.samples[i] / kFullScale);
    }
  }
  return out;
}

/// Where a burst begins in a sound, samples: by its likeness with the burst as it is, to a tenth of a sample.
double burst_near(const std::vector<double>& sound, double expected, double rate_hz) {
  const Bursts one{{0}};
  double best = -1;
  double place = 0;
  for (double at = expected - 100; at <= expected + 100; at += 0.1) {
    double likeness = 0;
    for (int i = 0; i < 240; ++i) {
      const double sample = at + i;
      const auto below = static_cast<std::size_t>(std::max(0.0, std::floor(sample)));
      if (below + 1 < sound.size()) {
        const double share = sample - static_cast<double>(below);
        likeness += one.at(static_cast<std::int64_t>(i * 1e9 / rate_hz)) *
                    (sound[below] * (1 - share) + sound[below + 1] * share);
      }
    }
    if (likeness > best) {
      best = likeness;
      place = at;
    }
  }
  return place;
}

class Capture : public testing::Test {
 protected:
  std::shared_ptr<CardScript> card() {
    auto script = std::shared_ptr<CardScript>(new CardScript{clock_});
    script->begin_ns = kBegin_ns;
    return script;
  }
  std::filesystem::path file(const char* name) const { return folder_.path() / name; }

  test::TemporaryFolder folder_;
  test::SetClock clock_{kBegin_ns};
};

// Picture, sound and timecode of a take of 100 s: the sound card's clock is 100 ppm fast, the timecode's box
// 20 ppm slow, the system says late by up to 5 ms what the card has. A frame is 33 ms, a half of it what may
// be; asserted is a fiftieth.
TEST_F(Capture, PictureSoundAndTimecodeLieTogether) {
  const auto script = card();
  script->format.channels = 2;
  script->drift_ppm = 100;
  const take::TimecodeRate rate{30, true, true};
  const take::TimecodeLabel first{9, 59, 30, 0};
  constexpr double kBoxPpm = -20;
  const std::int64_t box_begin_ns = kBegin_ns + 300'000'000;
  const double box_rate = script->rate_hz() / (1 + kBoxPpm * 1e-6);
  const std::vector<float> tape = test::ltc_tape(rate, first, 3600, box_rate);
  const std::int64_t take_begin_ns = kBegin_ns + 5 * kSecond_ns;
  std::vector<std::int64_t> frames;
  Bursts bursts;
  for (int n = 0; n < 3000; ++n) {
    frames.push_back(take_begin_ns + 123'456 + std::llround(n * 1e9 / 29.9931));
    if (n % 100 == 0) {
      bursts.times_ns.push_back(frames.back());
    }
  }
  script->wave = [&](std::int64_t sample, int channel) -> double {
    const auto time_ns =
        kBegin_ns + static_cast<std::int64_t>(static_cast<double>(sample) * 1e9 / script->rate_hz());
    if (channel == 0) {
      return bursts.at(time_ns);
    }
    const auto place =
        static_cast<std::int64_t>(script->sample_at(time_ns) - script->sample_at(box_begin_ns));
    return place >= 0 && place < static_cast<std::int64_t>(tape.size())
               ? 0.3 * tape[static_cast<std::size_t>(place)]
               : 0;
  };
  SoundCapture capture({"virtual", 48000, 2, 2, true}, std::make_unique<test::VirtualCard>(script));
  capture.start();
  script->run_until(take_begin_ns + 200'000'000);
  ASSERT_TRUE(capture.begin_take(file("a.flac"), 0));
  script->run_until(frames.back() + 100'000'000);
  const take::TakeTimecode timecode = capture.timecode(take_begin_ns);
  const take::TakeSound sound = capture.end_take();
  const SoundStatus status = capture.status();
  EXPECT_EQ(status.state, SoundState::Running);
  EXPECT_NEAR(status.rate_hz / 48000, 1 + 100e-6, 10e-6);
  EXPECT_NEAR(sound.rate_hz / 48000, 1 + 100e-6, 5e-6);
  EXPECT_EQ(sound.lost, 0);
  EXPECT_LE(sound.first_ns, take_begin_ns - kSecond_ns);

  // The sound as it is exported: sample 0 is the first frame's.
  const SoundCut cut{file("a.flac"), sound, frames.front(), frames.back() + 33'000'000, std::nullopt};
  write_sound(cut, SoundEncoding::Flac, file("b.flac"));
  const std::vector<double> heard = first_channel(file("b.flac"));
  double worst_ms = 0;
  for (std::size_t n = 100; n < frames.size(); n += 100) {
    const double expected = static_cast<double>(frames[n] - frames[0]) * 48e-6;
    const double beside_ms = (burst_near(heard, expected, 48000) - expected) / 48;
    worst_ms = std::max(worst_ms, std::abs(beside_ms));
  }
  EXPECT_LT(worst_ms, 0.7);

  // Every frame's timecode.
  ASSERT_EQ(timecode.spans.size(), 1U);
  EXPECT_EQ(take::to_text(timecode.rate), "29.97 drop");
  double worst_frames = 0;
  for (const std::int64_t time_ns : frames) {
    const double truth =
        static_cast<double>(time_ns - box_begin_ns) * 1e-9 * rate.hz() * (1 + kBoxPpm * 1e-6);
    const auto place = take::timecode_at(timecode, time_ns, 30);
    ASSERT_TRUE(place);
    const double said = static_cast<double>(place->count - take::frame_count(first, rate)) +
                        (place->thousandths + 0.5) / 1000;
    worst_frames = std::max(worst_frames, std::abs(said - truth));
  }
  EXPECT_LT(worst_frames, 0.02);
  RecordProperty("sound_worst_ms", fmt::format("{:.3f}", worst_ms));
  RecordProperty("timecode_worst_frames", fmt::format("{:.4f}", worst_frames));
  fmt::print("sound at most {:.3f} ms beside its frame, timecode {:.4f} frames\n", worst_ms, worst_frames);
}

TEST_F(Capture, WhatIsLostIsSilenceAndTheRestStaysInItsPlace) {
  const auto script = card();
  script->drift_ppm = -80;
  Bursts bursts;
  for (int i = 1; i < 40; ++i) {
    bursts.times_ns.push_back(kBegin_ns + i * kSecond_ns);
  }
  script->wave = [&](std::int64_t sample, int) {
    return bursts.at(kBegin_ns +
                     static_cast<std::int64_t>(static_cast<double>(sample) * 1e9 / script->rate_hz()));
  };
  SoundCapture capture({"virtual", 48000, 1, 0, true}, std::make_unique<test::VirtualCard>(script));
  capture.start();
  script->run_until(kBegin_ns + 10 * kSecond_ns);
  ASSERT_TRUE(capture.begin_take(file("a.flac"), 0));
  script->lose_samples = 24'000;
  script->run_until(kBegin_ns + 20 * kSecond_ns + kSecond_ns / 2);
  // Pulled out for five seconds.
  script->plugged = false;
  ASSERT_TRUE(test::eventually([&] { return capture.status().state == SoundState::Absent; }));
  EXPECT_THAT(capture.status().reason, HasSubstr("pulled out"));
  clock_.set(kBegin_ns + 25 * kSecond_ns + kSecond_ns / 2);
  script->plugged = true;
  ASSERT_TRUE(test::eventually([&] { return capture.status().state == SoundState::Running; }));
  script->run_until(kBegin_ns + 30 * kSecond_ns + kSecond_ns / 2);
  const take::TakeSound sound = capture.end_take();
  EXPECT_EQ(sound.reason, "");
  EXPECT_NEAR(static_cast<double>(sound.lost), 24'000 + 5 * 48'000, 300);
  EXPECT_EQ(capture.status().breaks, 2U);
  const SoundCut cut{file("a.flac"), sound, kBegin_ns + 9 * kSecond_ns, kBegin_ns + 30 * kSecond_ns,
                     std::nullopt};
  write_sound(cut, SoundEncoding::Flac, file("b.flac"));
  const std::vector<double> heard = first_channel(file("b.flac"));
  for (const int second : {12, 15, 20, 27, 29}) {
    const double expected = (second - 9) * 48'000.0;
    EXPECT_NEAR(burst_near(heard, expected, 48000), expected, 48) << second;
  }
  EXPECT_TRUE(std::all_of(heard.begin() + 12 * 48'000, heard.begin() + 16 * 48'000,
                          [](double value) { return value == 0; }));
}

TEST_F(Capture, ADeviceThatIsNotThereIsAState) {
  const auto script = card();
  script->plugged = false;
  SoundCapture capture({"virtual", 48000, 1, 0, true}, std::make_unique<test::VirtualCard>(script));
  EXPECT_EQ(capture.status().state, SoundState::Off);
  capture.start();
  ASSERT_TRUE(test::eventually([&] { return capture.status().state == SoundState::Absent; }));
  EXPECT_EQ(capture.status().reason, "the virtual card is not plugged in");
  try {
    capture.begin_take(file("a.flac"), 0);
    FAIL();
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(), "there is no sound: the virtual card is not plugged in");
  }
  EXPECT_FALSE(capture.take_sound().is_there());
  EXPECT_THAT(capture.take_sound().reason, HasSubstr("not plugged in"));
  EXPECT_FALSE(std::filesystem::exists(file("a.flac")));
  script->plugged = true;
  script->until_ns = kBegin_ns + kSecond_ns;
  ASSERT_TRUE(test::eventually([&] { return capture.status().state == SoundState::Running; }));
  capture.stop();
  EXPECT_TRUE(capture.finished());
}

TEST_F(Capture, ADeviceWithoutAClockIsRefused) {
  const auto script = card();
  script->drift_ppm = 5e6;  // six times as fast: no sound card, but ALSA's "null"
  script->until_ns = kBegin_ns + 60 * kSecond_ns;
  SoundCapture capture({"virtual", 48000, 1, 0, true}, std::make_unique<test::VirtualCard>(script));
  capture.start();
  ASSERT_TRUE(test::eventually([&] { return capture.status().state == SoundState::Absent; }));
  EXPECT_THAT(capture.status().reason, HasSubstr("has no clock"));
}

TEST_F(Capture, TheTimecodesChannelIsRecordedWhereItIsAlone) {
  for (const int channels : {1, 3}) {
    const auto script = card();
    script->begin_ns = clock_.now().time_since_epoch().count();
    script->format.channels = channels;
    script->wave = [](std::int64_t, int channel) { return (channel + 1) / 16.0; };
    SoundCapture capture({"virtual", 48000, channels, channels == 1 ? 1 : 2, true},
                         std::make_unique<test::VirtualCard>(script));
    capture.start();
    script->run_until(script->begin_ns + 2 * kSecond_ns);
    ASSERT_TRUE(capture.begin_take(file("a.flac"), 0));
    script->run_until(script->begin_ns + 3 * kSecond_ns);
    capture.end_take();
    FlacReader reader(file("a.flac"));
    EXPECT_EQ(reader.format().channels, channels == 1 ? 1 : 2);
    FlacReader::Block block;
    ASSERT_TRUE(reader.next(block));
    EXPECT_NEAR(block.samples.at(0) / kFullScale, 1 / 16.0, 1e-6);
    EXPECT_NEAR(block.samples.at(1) / kFullScale, channels == 1 ? 1 / 16.0 : 3 / 16.0, 1e-6);
    EXPECT_NEAR(capture.status().peak_dbfs, 20 * std::log10(channels == 1 ? 1 / 16.0 : 3 / 16.0), 0.01);
    std::filesystem::remove(file("a.flac"));
  }
}

TEST_F(Capture, NothingIsRecordedWhereNothingIsWanted) {
  const auto script = card();
  SoundCapture capture({"virtual", 48000, 1, 1, false}, std::make_unique<test::VirtualCard>(script));
  capture.start();
  script->run_until(kBegin_ns + kSecond_ns);
  EXPECT_FALSE(capture.begin_take(file("a.flac"), 0));
  EXPECT_FALSE(capture.end_take().is_there());
  EXPECT_FALSE(std::filesystem::exists(file("a.flac")));
}

TEST(SoundClock, IsRightThoughTheSystemIsLateNowAndThen) {
  SoundClock clock(48000);
  std::mt19937 random(1);
  constexpr double kRate = 48000 * (1 - 150e-6);
  for (int i = 0; i < 1000; ++i) {
    const auto sample = static_cast<std::int64_t>(i * 4800);
    const double late_ns = static_cast<double>(random() % 200'000) + (random() % 10 == 0 ? 20e6 : 0);
    clock.add(sample, kBegin_ns + std::llround(static_cast<double>(sample) * 1e9 / kRate + late_ns));
  }
  EXPECT_TRUE(clock.settled());
  EXPECT_NEAR(clock.rate_hz(), kRate, 48000 * 5e-6);
  const double truth = 999 * 4800 * 1e9 / kRate;
  EXPECT_NEAR(static_cast<double>(clock.time_of(999 * 4800) - kBegin_ns), truth + 100'000, 60'000);
  EXPECT_NEAR(clock.sample_at(clock.time_of(1'000'000)), 1'000'000, 0.01);
}

}  // namespace
}  // namespace facet::sound
