#pragma once

#include <ltc.h>

#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "take/take_time.hpp"

namespace facet::test {

/// Linear timecode as a box plays it, made by libltc.
///
/// samples_a_second: of the timecode's own seconds, which counts both its clock and the sound's
/// frames: how many, from `first` on
/// returns -1 to 1, one value a sample; frame n begins at sample n * samples_a_second / rate.hz()
inline std::vector<float> ltc_tape(const take::TimecodeRate& rate, const take::TimecodeLabel& first,
                                   std::int64_t frames, double samples_a_second) {
  const LTC_TV_STANDARD standard = rate.nominal == 25   ? LTC_TV_625_50
                                   : rate.nominal == 24 ? LTC_TV_FILM_24
                                                        : LTC_TV_525_60;
  const std::unique_ptr<LTCEncoder, decltype(&ltc_encoder_free)> encoder(
      ltc_encoder_create(samples_a_second, rate.hz(), standard, 0), &ltc_encoder_free);
  ltc_encoder_set_buffersize(encoder.get(), samples_a_second, 20);
  std::vector<float> tape;
  for (std::int64_t n = 0; n < frames; ++n) {
    const std::int64_t count = take::frame_count(first, rate) + n;
    const take::TimecodeLabel label = take::timecode_label(count, rate);
    SMPTETimecode time{};
    time.hours = static_cast<unsigned char>(label.hours);
    time.mins = static_cast<unsigned char>(label.minutes);
    time.secs = static_cast<unsigned char>(label.seconds);
    time.frame = static_cast<unsigned char>(label.frames);
    ltc_encoder_set_timecode(encoder.get(), &time);
    // The encoder takes a rate of 29.97 for drop-frame.
    LTCFrame frame{};
    ltc_encoder_get_frame(encoder.get(), &frame);
    frame.dfbit = rate.drop ? 1U : 0U;
    ltc_frame_set_parity(&frame, standard);
    ltc_encoder_set_frame(encoder.get(), &frame);
    ltc_encoder_encode_frame(encoder.get());
    ltcsnd_sample_t* bytes = nullptr;
    const int count_bytes = ltc_encoder_get_bufferptr(encoder.get(), &bytes, 1);
    for (int i = 0; i < count_bytes; ++i) {
      tape.push_back((static_cast<float>(bytes[i]) - 128.0F) / 128.0F);
    }
  }
  return tape;
}

}  // namespace facet::test
