// Timecode: how it counts, what is heard of it, and what stays of it in a take.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "sound/ltc_reader.hpp"
#include "sound/sound_source.hpp"
#include "sound/timecode_follower.hpp"
#include "support/ltc_tape.hpp"

namespace facet::sound {
namespace {

using take::TimecodeLabel;
using take::TimecodePlace;
using take::TimecodeRate;

const TimecodeRate kDrop{30, true, true};

std::string label_text(std::int64_t count, const TimecodeRate& rate) {
  return take::to_text(TimecodePlace{count, 0, rate});
}

TEST(Timecode, CountsThereAndBack) {
  for (const TimecodeRate& rate : {TimecodeRate{24}, TimecodeRate{24, true}, TimecodeRate{25},
                                   TimecodeRate{30}, TimecodeRate{30, true}, kDrop}) {
    for (std::int64_t count = 0; count < rate.frames_a_day(); count += 7) {
      const TimecodeLabel label = take::timecode_label(count, rate);
      ASSERT_EQ(take::frame_count(label, rate), count) << take::to_text(rate);
      ASSERT_TRUE(!rate.drop || label.seconds != 0 || label.frames > 1 || label.minutes % 10 == 0);
    }
    EXPECT_EQ(take::timecode_rate(take::to_text(rate)), rate);
  }
  EXPECT_EQ(take::timecode_rate("29.97 drop"), kDrop);
  EXPECT_FALSE(take::timecode_rate("29.97 "));
  EXPECT_FALSE(take::timecode_rate("0"));
}

TEST(Timecode, DropFrameLeavesNumbersOut) {
  EXPECT_EQ(label_text(1799, kDrop), "00:00:59;29");
  EXPECT_EQ(label_text(1800, kDrop), "00:01:00;02");
  EXPECT_EQ(label_text(17981, kDrop), "00:09:59;29");
  EXPECT_EQ(label_text(17982, kDrop), "00:10:00;00");
  EXPECT_EQ(label_text(107892, kDrop), "01:00:00;00");
  EXPECT_EQ(label_text(-1, kDrop), "23:59:59;29");
  EXPECT_EQ(kDrop.frames_a_day(), 2589408);
}

TEST(Timecode, TheTimeOfDayIsATimecode) {
  take::TakeTimecode clock;
  clock.source = take::TimecodeSource::Clock;
  clock.utc_minus_monotonic_ns = 1'700'000'000'000'000'000;  // 22:13:20 UTC
  const auto place = take::timecode_at(clock, 500'000'000, 59.94);
  ASSERT_TRUE(place);
  EXPECT_EQ(take::to_text(*place), "22:13:20:30");
  EXPECT_EQ(take::to_text(*take::timecode_at(clock, -2'500'000'000, 24)), "22:13:17:12");
}

TEST(Timecode, StaysInATakesMeta) {
  take::TakeTimecode timecode;
  timecode.source = take::TimecodeSource::Ltc;
  timecode.rate = kDrop;
  for (int i = 0; i < 300; ++i) {
    timecode.spans.push_back(
        {i * 1'000'000'000LL + 5, i * 1'000'000'000LL + 900'000'000, 1000 + i, 33366700.5});
  }
  std::map<std::string, std::string, std::less<>> meta;
  for (const auto& [key, value] : take::to_meta(timecode)) {
    EXPECT_LE(value.size(), 4096U);
    EXPECT_TRUE(meta.emplace(key, value).second) << key;
  }
  const auto text_of = [&](std::string_view key) {
    const auto found = meta.find(key);
    return found != meta.end() ? found->second : std::string();
  };
  const take::TakeTimecode back = take::timecode_of(text_of);
  EXPECT_EQ(back.rate, kDrop);
  EXPECT_EQ(back.spans, timecode.spans);
  // Outside bytes: what is not sound is left out, and what stands behind it.
  for (const char* bad :
       {"1 2 3", "5 1 0 4e7;", "1 2 99999999 4e7;", "1 2 3 nan;", "1 2 3 0;", "x", "1 2 3 4e7"}) {
    meta["timecode_spans"] = bad;
    EXPECT_TRUE(take::timecode_of(text_of).spans.size() <= 299) << bad;
    EXPECT_FALSE(take::timecode_at(take::timecode_of(text_of), 1, 30)) << bad;
  }
  meta["timecode_rate"] = "31.5";
  EXPECT_EQ(take::timecode_of(text_of).source, take::TimecodeSource::None);
}

/// A tape through the decoder and the follower, as a card at 48 kHz without drift would bring it.
class Tape {
 public:
  void play(const std::vector<float>& tape, std::int64_t gap_samples = 0, bool backwards = false) {
    at_ += gap_samples;
    std::vector<std::int32_t> samples;
    std::transform(tape.begin(), tape.end(), std::back_inserter(samples), [this](float value) {
      return static_cast<std::int32_t>(value * level * kFullScale * 0.99F);
    });
    if (backwards) {
      std::reverse(samples.begin(), samples.end());
    }
    for (std::size_t i = 0; i < samples.size(); i += 480) {
      const std::span<const std::int32_t> all(samples);
      const auto piece = all.subspan(i, std::min<std::size_t>(480, samples.size() - i));
      std::vector<LtcFrame> found;
      reader_.read(piece, at_, found);
      at_ += static_cast<std::int64_t>(piece.size());
      for (const LtcFrame& frame : found) {
        heard.push_back(frame);
        follower.add(frame, time_of(frame.first_sample), time_of(frame.end_sample));
      }
    }
  }
  static std::int64_t time_of(std::int64_t sample) {
    return 1'000'000'000'000 + std::llround(static_cast<double>(sample) * 1e9 / 48000);
  }
  std::int64_t now() const { return at_; }

  float level = 0.5F;
  std::vector<LtcFrame> heard;
  TimecodeFollower follower;

 private:
  LtcReader reader_{48000};
  std::int64_t at_ = 0;
};

TEST(TimecodeFollower, KnowsEveryRateFromItsSound) {
  for (const TimecodeRate& rate : {TimecodeRate{24}, TimecodeRate{24, true}, TimecodeRate{25},
                                   TimecodeRate{30}, TimecodeRate{30, true}, kDrop}) {
    for (const float level : {0.9F, 0.02F}) {
      Tape tape;
      tape.level = level;
      const TimecodeLabel first{9, 59, 58, 12};
      const std::int64_t frames = 10 * rate.nominal;
      tape.play(test::ltc_tape(rate, first, frames, 48000));
      const take::TakeTimecode timecode = tape.follower.timecode(0);
      ASSERT_EQ(timecode.source, take::TimecodeSource::Ltc) << take::to_text(rate);
      EXPECT_EQ(take::to_text(timecode.rate), take::to_text(rate));
      ASSERT_EQ(timecode.spans.size(), 1U) << take::to_text(rate);
      // In the middle of every frame it is that frame, and at its edges within a hundredth.
      for (std::int64_t n = 1; n < frames - 1; ++n) {
        const double begin = static_cast<double>(n) * 48000 / rate.hz();
        const auto middle =
            take::timecode_at(timecode, Tape::time_of(std::llround(begin + 24000 / rate.hz())), 30);
        ASSERT_TRUE(middle) << n;
        ASSERT_EQ(middle->count, take::frame_count(first, rate) + n) << take::to_text(rate);
        ASSERT_NEAR(middle->thousandths, 500, 5) << take::to_text(rate) << " " << n;
      }
    }
  }
}

TEST(TimecodeFollower, JumpsBeginSpansAndSilenceIsBridgedForTwoSeconds) {
  const TimecodeRate rate{25};
  Tape tape;
  tape.play(test::ltc_tape(rate, {1, 0, 0, 0}, 50, 48000));
  tape.play(test::ltc_tape(rate, {1, 0, 3, 0}, 50, 48000), 48000);       // a second was not heard, but ran on
  tape.play(test::ltc_tape(rate, {1, 30, 0, 0}, 50, 48000));             // a jump, without a gap
  tape.play(test::ltc_tape(rate, {1, 30, 0, 0}, 50, 48000), 5 * 48000);  // long silence, and another
  const take::TakeTimecode timecode = tape.follower.timecode(0);
  ASSERT_EQ(timecode.spans.size(), 3U);
  const auto text_at = [&](double seconds) {
    const auto place = take::timecode_at(timecode, Tape::time_of(std::llround(seconds * 48000)), 30);
    return place ? take::to_text(*place) : std::string("unknown");
  };
  EXPECT_EQ(text_at(0.02), "01:00:00:00");
  EXPECT_EQ(text_at(2.5), "01:00:02:12");  // in the gap
  EXPECT_EQ(text_at(4.9), "01:00:04:22");
  EXPECT_EQ(text_at(5.1), "01:30:00:02");
  EXPECT_EQ(text_at(8.9), "01:30:03:22");  // the flywheel
  EXPECT_EQ(text_at(9.2), "unknown");
  EXPECT_EQ(text_at(12.5), "01:30:00:12");
  EXPECT_EQ(text_at(-0.1), "unknown");
  EXPECT_EQ(take::to_text(*take::timecode_near(timecode, Tape::time_of(-4800), 30)), "00:59:59:22");
}

TEST(TimecodeFollower, ATapeThatRunsBackwardsCountsDown) {
  const TimecodeRate rate{25};
  Tape tape;
  tape.play(test::ltc_tape(rate, {2, 0, 0, 0}, 100, 48000), 0, true);
  const take::TakeTimecode timecode = tape.follower.timecode(0);
  ASSERT_EQ(timecode.spans.size(), 1U);
  EXPECT_LT(timecode.spans[0].frame_ns, 0);
  // Frame 99 was first, frame 74 a second later.
  const auto place = take::timecode_at(timecode, Tape::time_of(48000 + 960), 30);
  ASSERT_TRUE(place);
  EXPECT_NEAR(static_cast<double>(place->count - take::frame_count({2, 0, 0, 0}, rate)), 74, 1);
}

TEST(TimecodeFollower, WrongFramesDoNotBreakARun) {
  const TimecodeRate rate{25};
  TimecodeFollower follower;
  std::mt19937 random(3);
  const auto frame_ns = 40'000'000LL;
  for (int n = 0; n < 500; ++n) {
    LtcFrame frame;
    frame.label = take::timecode_label(1000 + n, rate);
    if (n > 20 && random() % 4 == 0) {
      frame.label.minutes = static_cast<int>(random() % 60);
      frame.label.seconds = static_cast<int>(random() % 60);
    }
    follower.add(frame, 5'000'000'000 + n * frame_ns, 5'000'000'000 + (n + 1) * frame_ns);
  }
  const take::TakeTimecode timecode = follower.timecode(0);
  ASSERT_EQ(timecode.spans.size(), 1U);
  EXPECT_EQ(take::timecode_at(timecode, 5'000'000'000 + 400 * frame_ns + 1000, 30)->count, 1400);
}

TEST(TimecodeFollower, NoiseIsNoTimecode) {
  Tape tape;
  std::mt19937 random(11);
  std::vector<float> noise(48000 * 5);
  std::generate(noise.begin(), noise.end(),
                [&] { return static_cast<float>(random() % 2000) / 1000.0F - 1.0F; });
  tape.play(noise);
  EXPECT_EQ(tape.follower.timecode(0).source, take::TimecodeSource::None);
}

}  // namespace
}  // namespace facet::sound
