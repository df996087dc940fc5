#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace facet::sound {

/// What a source gives.
struct SoundFormat {
  int rate_hz = 0;  ///< as it says; its clock is measured (SoundClock)
  int channels = 0;
  int bits = 0;  ///< that a sample has, 16 or 24

  bool operator==(const SoundFormat&) const = default;
};

/// A sample is a whole number of 24 bits, -2^23 to 2^23 - 1; one of 16 bits stands in the upper ones.
inline constexpr int kSampleBits = 24;
inline constexpr double kFullScale = 1 << (kSampleBits - 1);

/// What one read gives: the samples that follow those of the read before, unless some were lost.
struct SoundBlock {
  std::vector<std::int32_t> samples;  ///< [sample_count][channels]
  /// How many samples of each channel the source had taken at `time_ns` of those that follow the block
  /// before: those of this block, and those that the next ones will bring.
  std::int64_t taken = 0;
  std::int64_t time_ns = 0;  ///< CLOCK_MONOTONIC
  bool lost_before = false;  ///< samples before these were lost, nobody knows how many
};

enum class SoundEvent {
  Samples,  ///< the block has some
  Nothing,  ///< none came for a while
  Gone,     ///< the device is: `reason` says why. It is to be opened anew
};

/// What gives sound: a sound card, or a test in its place. One thread.
class SoundSource {
 public:
  SoundSource() = default;
  SoundSource(const SoundSource&) = delete;
  SoundSource& operator=(const SoundSource&) = delete;
  virtual ~SoundSource() = default;

  /// Begins, anew where it was open. Throws Error(Unavailable) with a reason for people where it can't.
  virtual SoundFormat open() = 0;
  /// Waits 100 ms at most. The block's memory is reused.
  virtual SoundEvent read(SoundBlock& block) = 0;
  /// Why it is gone.
  virtual std::string reason() const = 0;
  virtual void close() = 0;
};

}  // namespace facet::sound
