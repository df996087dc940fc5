#include "sound/ltc_reader.hpp"

#include <ltc.h>

#include <algorithm>
#include <new>

#include "sound/sound_source.hpp"

namespace facet::sound {
namespace {

constexpr int kTypicalFrames_hz = 25;
constexpr int kQueue = 64;

struct FreeDecoder {
  void operator()(LTCDecoder* decoder) const { ltc_decoder_free(decoder); }
};

/// Where the digits are none of a time, nothing was understood.
bool is_label(const take::TimecodeLabel& label) {
  return label.hours < 24 && label.minutes < 60 && label.seconds < 60 && label.frames < 30;
}

}  // namespace

struct LtcReader::Impl {
  std::unique_ptr<LTCDecoder, FreeDecoder> decoder;
  std::vector<float> values;
};

LtcReader::LtcReader(int rate_hz) : impl_(std::make_unique<Impl>()) {
  impl_->decoder.reset(ltc_decoder_create(rate_hz / kTypicalFrames_hz, kQueue));
  if (impl_->decoder == nullptr) {
    throw std::bad_alloc();
  }
}

LtcReader::~LtcReader() = default;

void LtcReader::read(std::span<const std::int32_t> samples, std::int64_t first,
                     std::vector<LtcFrame>& found) {
  impl_->values.resize(samples.size());
  std::transform(samples.begin(), samples.end(), impl_->values.begin(),
                 [](std::int32_t value) { return static_cast<float>(value / kFullScale); });
  ltc_decoder_write_float(impl_->decoder.get(), impl_->values.data(), impl_->values.size(), first);
  LTCFrameExt heard{};
  while (ltc_decoder_read(impl_->decoder.get(), &heard) != 0) {
    SMPTETimecode time{};
    ltc_frame_to_time(&time, &heard.ltc, 0);
    const take::TimecodeLabel label{time.hours, time.mins, time.secs, time.frame};
    if (is_label(label) && heard.off_end > heard.off_start) {
      found.push_back({heard.off_start, heard.off_end + 1, label, heard.ltc.dfbit != 0, heard.reverse != 0});
    }
  }
}

}  // namespace facet::sound
