#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>

#include "sound/sound_source.hpp"
#include "take/reader.hpp"
#include "take/take_time.hpp"

namespace facet::sound {

/// A stretch of a take's sound.
struct SoundCut {
  std::filesystem::path file;  ///< take::sound_file_of the take
  take::TakeSound sound;
  std::int64_t from_ns = 0;  ///< CLOCK_MONOTONIC
  std::int64_t to_ns = 0;
  /// Seconds since midnight of its beginning in the take's timecode, for the head of a WAV (BWF's
  /// TimeReference, by which editors place it); none: not known.
  std::optional<double> timecode_s;
};

/// Reads it at the device's nominal rate: sample k is what was heard at from_ns + k / rate. The device's own
/// clock is taken out by a band-limited interpolation (windowed sinc, 32 samples), so that picture and sound
/// stay together however long it is; where there is no sound, there is silence. One thread.
class SoundReader {
 public:
  /// Throws Error(UnreadableInput) where the take has no sound or it can't be read.
  explicit SoundReader(const SoundCut& cut);
  ~SoundReader();
  SoundReader(const SoundReader&) = delete;
  SoundReader& operator=(const SoundReader&) = delete;

  const SoundFormat& format() const;
  std::int64_t count() const;  ///< samples of each channel, all in all
  /// The next [at most `most` and some thousand][channels], 24 bits, until the next call; none: the end, or
  /// `most` is 0. Throws Error(UnreadableInput).
  std::span<const std::int32_t> next(std::int64_t most);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

enum class SoundEncoding { Wav, Flac };

/// Writes what SoundReader reads as a file of its own, which appears whole or not at all. Throws as that
/// does, Error(Usage) where a WAV would be longer than 4 GiB, Error(Storage). Returns the samples of each
/// channel.
std::int64_t write_sound(const SoundCut& cut, SoundEncoding encoding, const std::filesystem::path& out);

/// Copies the part of a take's sound that lies around a stretch into a file of another take, as it is:
/// nothing is resampled. Returns what that take's `meta` is to say. Throws as write_sound does.
take::TakeSound copy_sound(const SoundCut& cut, const std::filesystem::path& out);

/// take::CutConfig::beside: the sound of the time that is cut out, beside the new take. What can't be read of
/// it is left out with a reason. Throws Error(Storage).
take::MetaEntries cut_beside(const take::TakeInfo& from, std::int64_t from_ns, std::int64_t to_ns,
                             const std::filesystem::path& file);

}  // namespace facet::sound
