#include "take_film.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>

#include "exports/export.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "progress.hpp"
#include "render/video_writer.hpp"
#include "report/film.hpp"
#include "take_frames.hpp"
#include "take_sound.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

/// Frames that the take lacks and the picture before them is sent again for; over longer gaps it is shown
/// once, for as long as they are.
constexpr std::uint64_t kLongestHold = 3600;

/// images may be null; first: a frame that they are asked for. A set of several cameras' pictures gives none.
std::vector<report::FilmPanel> panels_of(const std::string& text, report::SourceImages* images,
                                         std::uint64_t first) {
  if (!text.empty()) {
    return report::parse_film_panels(text);
  }
  const bool has_pictures = images != nullptr && images->at(first).has_value();
  return report::parse_film_panels(has_pictures ? "picture,grey,skin" : "grey,skin");
}

/// "frame 120   0:04.00", and the timecode where there is one.
std::string line_of(const mesh::MeshFrame& frame, double time_s, const exports::Timeline& timeline) {
  const auto hundredths = static_cast<long>(std::lround(time_s * 100));
  std::string text = fmt::format("frame {}   {}:{:02}.{:02}", frame.sequence, hundredths / 6000,
                                 hundredths / 100 % 60, hundredths % 100);
  if (const auto place = take::timecode_at(timeline.timecode, frame.timestamp_ns, timeline.rate_hz)) {
    text += "   TC " + take::to_text(*place);
  }
  return text;
}

/// The film's first timecode, where it counts as the film does.
std::string timecode_of(const exports::Timeline& timeline) {
  const auto place = exports::start_timecode(timeline);
  return place && render::takes_timecode(timeline.rate_hz) &&
                 std::abs(place->rate.hz() - timeline.rate_hz) < 0.02 * timeline.rate_hz
             ? take::to_text(*place)
             : std::string();
}

/// A take's sound on its way into a film, which does without what of it can't be had.
class FilmTrack {
 public:
  FilmTrack(take::TakeReader& take, std::int64_t from_ns, std::int64_t to_ns) {
    const take::TakeInfo& info = take.info();
    std::string fault = info.sound.is_there() ? "" : info.sound.reason;
    try {
      if (info.sound.is_there()) {
        reader_.emplace(
            sound::SoundCut{take::sound_file_of(info.file), info.sound, from_ns, to_ns, std::nullopt});
        fault = render::fault_of(*format());
      }
    } catch (const Error& error) {
      fault = error.what();
    }
    if (!fault.empty()) {
      reader_.reset();
      tell(stderr, "note: the film has no sound: {}\n", fault);
    }
  }

  std::optional<render::FilmSound> format() const {
    return reader_ ? std::optional(render::FilmSound{reader_->format().rate_hz, reader_->format().channels})
                   : std::nullopt;
  }
  /// What is heard before time_s and was not appended yet.
  void append_until(double time_s, render::VideoWriter& film) {
    if (!reader_) {
      return;
    }
    const auto until = static_cast<std::int64_t>(std::llround(time_s * reader_->format().rate_hz));
    while (done_ < until) {
      const auto samples = next(until - done_);
      if (samples.empty()) {
        return;
      }
      film.append_sound(samples);
      done_ += static_cast<std::int64_t>(samples.size()) / reader_->format().channels;
    }
  }

 private:
  /// None at the end, and where the rest can't be read, which is said once.
  std::span<const std::int32_t> next(std::int64_t most) {
    try {
      return is_broken_ ? std::span<const std::int32_t>() : reader_->next(most);
    } catch (const Error& error) {
      is_broken_ = true;
      tell(stderr, "note: the film has no sound from {:.2f} s on: {}\n",
           static_cast<double>(done_) / reader_->format().rate_hz, error.what());
      return {};
    }
  }

  std::optional<sound::SoundReader> reader_;
  bool is_broken_ = false;
  std::int64_t done_ = 0;
};

}  // namespace

int export_film(take::TakeReader& take, const std::vector<std::int64_t>& indices, const FilmOptions& options,
                const StopSignals& signals) {
  if (std::filesystem::path(options.output).extension() != ".mp4") {
    throw Error(ErrorKind::Usage, "--format mp4 writes one file: name it with -o NAME.mp4");
  }
  exports::Timeline timeline = timeline_of(take, indices);
  timeline.timecode = take.info().timecode;
  const bool is_constant = timeline.times_s.empty();
  const std::unique_ptr<report::SourceImages> images = report::open_source_images(take.info(), options.video);
  report::FilmPainter painter(take, indices, images.get(),
                              panels_of(options.panels, images.get(), timeline.sequences.front()),
                              options.height_px);
  const std::int64_t frame_ns = std::llround(1e9 / timeline.rate_hz);
  FilmTrack sound(take, take.entry(indices.front()).timestamp_ns,
                  take.entry(indices.back()).timestamp_ns + frame_ns);

  files::make_folder(std::filesystem::absolute(options.output).parent_path());
  render::VideoFormat format{painter.width_px(),       painter.height_px(), timeline.rate_hz,
                             render::VideoCodec::Film, sound.format(),      timecode_of(timeline)};
  render::VideoWriter film(options.output, format);
  Progress progress("Drawing", indices.size());
  render::Picture picture;
  std::uint64_t next = timeline.sequences.front();
  double end_s = 0;
  for (const std::int64_t index : indices) {
    if (const int signal = signals.pending(); signal != 0) {
      tell(stderr, "facet: broken off: nothing was written to '{}'\n", options.output);
      return signal;
    }
    const auto frame = take.frame(index, take::Pictures::Described);
    const double time_s = exports::time_s(timeline, frame->sequence);
    if (is_constant && frame->sequence - next < kLongestHold) {
      for (; next < frame->sequence; ++next) {
        film.append(picture, exports::time_s(timeline, next));
      }
    }
    picture = painter.paint(*frame, line_of(*frame, time_s, timeline));
    film.append(picture, time_s);
    next = frame->sequence + 1;
    end_s = time_s + 1 / timeline.rate_hz;
    sound.append_until(end_s, film);
    progress.advance();
  }
  film.finish();
  progress.finish();
  tell("{}: {}x{} px, {:.2f} s at {}{:.6g} Hz, {}{}\n", options.output, format.width_px, format.height_px,
       end_s, is_constant ? "" : "a varying rate, on average ", timeline.rate_hz,
       format.sound ? "with sound" : "the take has no sound",
       format.timecode.empty() ? "" : ", timecode from " + format.timecode);
  return 0;
}

}  // namespace facet::tools
