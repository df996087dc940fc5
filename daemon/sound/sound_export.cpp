#include "sound/sound_export.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <numbers>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "sound/flac_file.hpp"

namespace facet::sound {
namespace {

/// Samples on either side of a place that its value is made of.
constexpr int kHalf = 16;
constexpr int kTaps = 2 * kHalf;
constexpr int kPhases = 512;
/// Of Kaiser's window: 80 dB.
constexpr double kBeta = 8;
constexpr std::int64_t kPiece = 4096;
constexpr std::uint64_t kMostWavBytes = 0xFFFF'0000;

/// Modified Bessel function of the first kind, order 0, by its series.
double bessel_0(double x) {
  double sum = 1;
  double term = 1;
  for (int k = 1; k < 40; ++k) {
    term *= x / (2 * k) * x / (2 * k);
    sum += term;
  }
  return sum;
}

/// Values between samples: kPhases + 1 rows of weights for the samples from place - kHalf + 1 on.
class Interpolator {
 public:
  Interpolator() : weights_(std::size_t{kPhases + 1} * kTaps) {
    for (int phase = 0; phase <= kPhases; ++phase) {
      for (int tap = 0; tap < kTaps; ++tap) {
        const double x = tap - (kHalf - 1) - static_cast<double>(phase) / kPhases;
        const double edge = x / kHalf;
        const double window =
            std::abs(edge) < 1 ? bessel_0(kBeta * std::sqrt(1 - edge * edge)) / bessel_0(kBeta) : 0;
        const double sinc = x == 0 ? 1 : std::sin(std::numbers::pi * x) / (std::numbers::pi * x);
        weights_[static_cast<std::size_t>(phase * kTaps + tap)] = window * sinc;
      }
    }
  }

  /// samples: kTaps of them, `stride` apart. fraction: 0 to 1 behind the one at kHalf - 1.
  double operator()(const std::int32_t* samples, std::size_t stride, double fraction) const {
    const double place = fraction * kPhases;
    const auto phase = std::min(static_cast<std::size_t>(place), std::size_t{kPhases - 1});
    const double share = place - static_cast<double>(phase);
    const double* const before = &weights_[phase * kTaps];
    double sum = 0;
    for (std::size_t tap = 0; tap < kTaps; ++tap) {
      sum += samples[tap * stride] * (before[tap] + share * (before[tap + kTaps] - before[tap]));
    }
    return sum;
  }

 private:
  std::vector<double> weights_;
};

/// A sound file's samples by number, rising; silence where it has none.
class SampleWindow {
 public:
  explicit SampleWindow(const std::filesystem::path& file) : reader_(file) {}

  const SoundFormat& format() const { return reader_.format(); }
  /// [count][channels] from `first` on, which is no smaller than in the call before.
  std::span<const std::int32_t> at(std::int64_t first, std::int64_t count);

 private:
  void append(std::int64_t until);

  FlacReader reader_;
  FlacReader::Block block_;
  std::size_t used_ = 0;  ///< values of the block
  bool ended_ = false;
  std::int64_t start_ = 0;  ///< number of the first in samples_
  std::vector<std::int32_t> samples_;
};

/// Appends samples up to the number `until`, not included.
void SampleWindow::append(std::int64_t until) {
  const auto channels = static_cast<std::size_t>(format().channels);
  while (true) {
    const std::int64_t next = start_ + static_cast<std::int64_t>(samples_.size() / channels);
    if (next >= until) {
      return;
    }
    const auto wanted = static_cast<std::size_t>(until - next) * channels;
    if (used_ >= block_.samples.size()) {
      used_ = 0;
      block_.samples.clear();
      ended_ = ended_ || !reader_.next(block_);
    }
    const std::int64_t block_next = block_.first + static_cast<std::int64_t>(used_ / channels);
    if (ended_ || block_next > next) {
      const std::int64_t silent = ended_ ? until - next : std::min(until, block_next) - next;
      samples_.resize(samples_.size() + static_cast<std::size_t>(silent) * channels, 0);
      continue;
    }
    // What stands before, as after a start in the middle, is passed over.
    const auto passed = static_cast<std::size_t>(next - block_next) * channels;
    if (used_ + passed >= block_.samples.size()) {
      used_ = block_.samples.size();
      continue;
    }
    used_ += passed;
    const std::size_t taken = std::min(wanted, block_.samples.size() - used_);
    const auto from = block_.samples.begin() + static_cast<std::ptrdiff_t>(used_);
    samples_.insert(samples_.end(), from, from + static_cast<std::ptrdiff_t>(taken));
    used_ += taken;
  }
}

std::span<const std::int32_t> SampleWindow::at(std::int64_t first, std::int64_t count) {
  const auto channels = static_cast<std::size_t>(format().channels);
  const auto held = static_cast<std::int64_t>(samples_.size() / channels);
  const std::int64_t gone = std::clamp<std::int64_t>(first - start_, 0, held);
  samples_.erase(samples_.begin(), samples_.begin() + static_cast<std::ptrdiff_t>(gone) *
                                                          static_cast<std::ptrdiff_t>(channels));
  start_ = samples_.empty() ? first : start_ + gone;
  append(first + count);
  return std::span(samples_).first(static_cast<std::size_t>(count) * channels);
}

void append_text(std::vector<std::byte>& out, std::string_view text, std::size_t bytes) {
  const auto begin = std::as_bytes(std::span(text));
  out.insert(out.end(), begin.begin(), begin.end());
  out.resize(out.size() + bytes - text.size());
}

void append_number(std::vector<std::byte>& out, std::uint64_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) {
    out.push_back(static_cast<std::byte>(value >> static_cast<unsigned>(8 * i)));
  }
}

/// The head of a Broadcast Wave file (EBU Tech 3285), up to its samples.
std::vector<std::byte> wav_head(const SoundFormat& format, std::uint64_t data_bytes,
                                const std::optional<double>& timecode_s) {
  constexpr std::size_t kDescription = 256;
  constexpr std::size_t kNameAndTime = 32 + 32 + 10 + 8;
  constexpr std::uint32_t kBextBytes = 602;
  const int sample_bytes = format.bits / 8;
  std::vector<std::byte> head;
  append_text(head, "RIFF", 4);
  append_number(head, 4 + (timecode_s ? 8 + kBextBytes : 0) + 8 + 16 + 8 + data_bytes + data_bytes % 2, 4);
  append_text(head, "WAVE", 4);
  if (timecode_s) {
    append_text(head, "bext", 4);
    append_number(head, kBextBytes, 4);
    append_text(head, "Facet", kDescription);
    append_text(head, "", kNameAndTime);
    append_number(head, static_cast<std::uint64_t>(std::llround(*timecode_s * format.rate_hz)), 8);
    append_number(head, 1, 2);  // version
    append_text(head, "", 64 + 190);
  }
  append_text(head, "fmt ", 4);
  append_number(head, 16, 4);
  append_number(head, 1, 2);  // whole numbers
  append_number(head, static_cast<std::uint64_t>(format.channels), 2);
  append_number(head, static_cast<std::uint64_t>(format.rate_hz), 4);
  append_number(head, static_cast<std::uint64_t>(format.rate_hz * format.channels * sample_bytes), 4);
  append_number(head, static_cast<std::uint64_t>(format.channels * sample_bytes), 2);
  append_number(head, static_cast<std::uint64_t>(format.bits), 2);
  append_text(head, "data", 4);
  append_number(head, data_bytes, 4);
  return head;
}

/// One file of sound that comes into being whole.
class SoundOut {
 public:
  SoundOut(const std::filesystem::path& file, SoundEncoding encoding, const SoundFormat& format,
           std::int64_t samples, const std::optional<double>& timecode_s)
      : out_(file), format_(format) {
    if (encoding == SoundEncoding::Flac) {
      flac_.emplace(format, [this](std::span<const std::byte> bytes, std::uint64_t position) {
        // Not through a library of C.
        try {
          out_.write_at(position, bytes);
          return true;
        } catch (...) {
          fault_ = std::current_exception();
          return false;
        }
      });
      rethrow();
      return;
    }
    const std::uint64_t data_bytes =
        static_cast<std::uint64_t>(samples) * static_cast<std::uint64_t>(format.channels * format.bits / 8);
    if (data_bytes > kMostWavBytes) {
      throw Error(ErrorKind::Usage, fmt::format("'{}' would be longer than 4 GiB, the most that a WAV can "
                                                "have: choose fewer frames (--frames), or --format flac",
                                                file.string()));
    }
    out_.write(wav_head(format, data_bytes, timecode_s));
    odd_ = data_bytes % 2 != 0;
  }

  /// samples: [sample_count][channels], 24 bits
  void add(std::span<const std::int32_t> samples) {
    if (flac_) {
      flac_->add(samples);
      rethrow();
      return;
    }
    bytes_.clear();
    for (const std::int32_t sample : samples) {
      append_number(bytes_, static_cast<std::uint32_t>(sample >> (kSampleBits - format_.bits)),
                    format_.bits / 8);
    }
    out_.write(bytes_);
  }
  void commit() {
    if (flac_) {
      flac_->finish();
      rethrow();
    } else if (odd_) {
      out_.write(std::string_view("\0", 1));
    }
    out_.commit();
  }

 private:
  void rethrow() {
    if (fault_ != nullptr) {
      std::rethrow_exception(std::exchange(fault_, nullptr));
    }
  }

  files::OutputFile out_;
  std::exception_ptr fault_;  ///< what a write threw
  SoundFormat format_;
  std::optional<FlacEncoder> flac_;
  std::vector<std::byte> bytes_;
  bool odd_ = false;
};

/// The place of a time in the file, samples.
double place_of(const take::TakeSound& sound, std::int64_t time_ns) {
  return static_cast<double>(time_ns - sound.first_ns) * 1e-9 * sound.rate_hz;
}

void require_sound(const SoundCut& cut) {
  if (!cut.sound.is_there()) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("the take has no sound{}", cut.sound.reason.empty() ? "" : ": " + cut.sound.reason));
  }
  if (cut.to_ns < cut.from_ns || std::abs(place_of(cut.sound, cut.from_ns)) > 1e12 ||
      std::abs(place_of(cut.sound, cut.to_ns)) > 1e12) {
    throw Error(ErrorKind::UnreadableInput, "the take's frames are none of the time of its sound");
  }
}

}  // namespace

struct SoundReader::Impl {
  explicit Impl(const std::filesystem::path& file) : window(file) {}

  SampleWindow window;
  Interpolator interpolate;
  double start = 0;  ///< place in the file of sample 0
  double step = 1;   ///< samples of the file for each that is read
  std::int64_t count = 0;
  std::int64_t done = 0;
  std::vector<std::int32_t> piece;
};

SoundReader::SoundReader(const SoundCut& cut) {
  require_sound(cut);
  impl_ = std::make_unique<Impl>(cut.file);
  const int rate_hz = format().rate_hz;
  impl_->count =
      static_cast<std::int64_t>(std::llround(static_cast<double>(cut.to_ns - cut.from_ns) * 1e-9 * rate_hz));
  impl_->start = place_of(cut.sound, cut.from_ns);
  impl_->step = cut.sound.rate_hz / rate_hz;
}

SoundReader::~SoundReader() = default;

const SoundFormat& SoundReader::format() const {
  return impl_->window.format();
}

std::int64_t SoundReader::count() const {
  return impl_->count;
}

std::span<const std::int32_t> SoundReader::next(std::int64_t most) {
  constexpr auto kMost = static_cast<double>((1 << (kSampleBits - 1)) - 1);
  const auto channels = static_cast<std::size_t>(format().channels);
  const std::int64_t samples =
      std::clamp<std::int64_t>(most, 0, std::min(kPiece, impl_->count - impl_->done));
  impl_->piece.clear();
  if (samples == 0) {
    return {};
  }
  const auto place = [&](std::int64_t k) {
    return impl_->start + static_cast<double>(impl_->done + k) * impl_->step;
  };
  const auto from = static_cast<std::int64_t>(std::floor(place(0)));
  const auto last = static_cast<std::int64_t>(std::floor(place(samples - 1)));
  const auto around = impl_->window.at(from - kHalf + 1, last - from + kTaps);
  for (std::int64_t k = 0; k < samples; ++k) {
    const double whole = std::floor(place(k));
    const auto offset = static_cast<std::size_t>(static_cast<std::int64_t>(whole) - from) * channels;
    for (std::size_t c = 0; c < channels; ++c) {
      const double value = impl_->interpolate(&around[offset + c], channels, place(k) - whole);
      impl_->piece.push_back(static_cast<std::int32_t>(std::lround(std::clamp(value, -kMost - 1, kMost))));
    }
  }
  impl_->done += samples;
  return impl_->piece;
}

std::int64_t write_sound(const SoundCut& cut, SoundEncoding encoding, const std::filesystem::path& out) {
  SoundReader reader(cut);
  SoundOut file(out, encoding, reader.format(), reader.count(), cut.timecode_s);
  for (auto piece = reader.next(reader.count()); !piece.empty(); piece = reader.next(reader.count())) {
    file.add(piece);
  }
  file.commit();
  return reader.count();
}

take::TakeSound copy_sound(const SoundCut& cut, const std::filesystem::path& out) {
  require_sound(cut);
  SampleWindow window(cut.file);
  const SoundFormat format = window.format();
  take::TakeSound sound = cut.sound;
  const auto first =
      std::clamp<std::int64_t>(std::llround(place_of(cut.sound, cut.from_ns)), 0, sound.samples);
  const auto end =
      std::clamp<std::int64_t>(std::llround(place_of(cut.sound, cut.to_ns)), first, sound.samples);
  sound.first_ns += std::llround(static_cast<double>(first) * 1e9 / sound.rate_hz);
  sound.samples = end - first;
  SoundOut file(out, SoundEncoding::Flac, format, sound.samples, std::nullopt);
  for (std::int64_t done = first; done < end;) {
    const std::int64_t samples = std::min(kPiece, end - done);
    file.add(window.at(done, samples));
    done += samples;
  }
  file.commit();
  return sound;
}

take::MetaEntries cut_beside(const take::TakeInfo& from, std::int64_t from_ns, std::int64_t to_ns,
                             const std::filesystem::path& file) {
  if (!from.sound.is_there()) {
    return {};
  }
  const SoundCut cut{take::sound_file_of(from.file), from.sound, from_ns, to_ns, std::nullopt};
  try {
    return take::to_meta(copy_sound(cut, take::sound_file_of(file)));
  } catch (const Error& error) {
    if (error.kind() == ErrorKind::Storage) {
      throw;
    }
    take::TakeSound none;
    none.reason = error.what();
    return take::to_meta(none);
  }
}

}  // namespace facet::sound
