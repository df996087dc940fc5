#include "take_sound.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "files/output_file.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

constexpr double kUsualRate_hz = 30;

std::string start_text(const take::TakeTimecode& timecode, std::int64_t first_ns, double rate_hz) {
  const auto place = take::timecode_at(timecode, first_ns, rate_hz);
  return place ? take::to_text(*place) : "not known";
}

}  // namespace

void export_sound(take::TakeReader& take, const std::vector<std::int64_t>& indices,
                  sound::SoundEncoding encoding, const std::string& output) {
  const take::TakeInfo& info = take.info();
  const auto meshed = std::find_if(indices.begin(), indices.end(),
                                   [&](std::int64_t index) { return take.entry(index).has_mesh; });
  const take::FrameEntry first = take.entry(meshed != indices.end() ? *meshed : indices.front());
  const std::int64_t first_ns = first.timestamp_ns;
  const std::int64_t last_ns = take.entry(indices.back()).timestamp_ns;
  const double rate_hz = source_rate_hz(take);
  const std::int64_t frame_ns = std::llround(1e9 / rate_hz);
  sound::SoundCut cut{take::sound_file_of(info.file), info.sound, first_ns, last_ns + frame_ns, std::nullopt};
  if (const auto place = take::timecode_at(info.timecode, first_ns, rate_hz)) {
    cut.timecode_s = (static_cast<double>(place->count) + static_cast<double>(place->thousandths) / 1000) /
                     place->rate.hz();
  }
  files::make_folder(std::filesystem::absolute(output).parent_path());
  const std::int64_t samples = sound::write_sound(cut, encoding, output);
  tell("{}: {} samples at {} Hz, {:.3f} s; sample 0 is at frame {}\n", output, samples, info.sound.nominal_hz,
       static_cast<double>(samples) / static_cast<double>(std::max(1, info.sound.nominal_hz)),
       first.sequence);
}

double source_rate_hz(take::TakeReader& take) {
  if (take.frame_count() < 2 || !(take.info().duration_s > 0)) {
    return kUsualRate_hz;
  }
  const auto first = static_cast<double>(take.entry(0).sequence);
  const auto last = static_cast<double>(take.entry(take.frame_count() - 1).sequence);
  const double rate_hz = (last - first) / take.info().duration_s;
  return rate_hz >= 1 && rate_hz <= 1000 ? rate_hz : kUsualRate_hz;
}

void print_time(take::TakeReader& take) {
  const take::TakeInfo& info = take.info();
  if (info.timecode.source != take::TimecodeSource::None && take.frame_count() > 0) {
    const bool ltc = info.timecode.source == take::TimecodeSource::Ltc;
    tell("timecode      from {}, {}\n",
         start_text(info.timecode, info.first_timestamp_ns, source_rate_hz(take)),
         ltc ? fmt::format("LTC at {} frames per second, {} span{}", take::to_text(info.timecode.rate),
                           info.timecode.spans.size(), info.timecode.spans.size() == 1 ? "" : "s")
             : std::string("the time of day (UTC)"));
  }
  const take::TakeSound& sound = info.sound;
  if (sound.is_there()) {
    tell("sound         {:.1f} s at {} Hz ({:+.1f} ppm), from {:.3f} s before the first frame{}\n",
         static_cast<double>(sound.samples) / sound.rate_hz, sound.nominal_hz,
         (sound.rate_hz / sound.nominal_hz - 1) * 1e6,
         static_cast<double>(info.first_timestamp_ns - sound.first_ns) * 1e-9,
         sound.lost > 0 ? fmt::format(", {} samples lost", sound.lost) : "");
  }
  if (!sound.reason.empty()) {
    tell("sound         {}: {}\n", sound.is_there() ? "ended early" : "none", sound.reason);
  }
}

}  // namespace facet::tools
