#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "sound/sound_source.hpp"

namespace facet::sound {

/// Encodes sound as FLAC (RFC 9639) while it comes: what is there can be read at any time, and says only at
/// the end how long it is. One thread.
class FlacEncoder {
 public:
  /// Puts bytes in their place; false: they are not there, and nothing more is encoded.
  using Write = std::function<bool(std::span<const std::byte> bytes, std::uint64_t position)>;

  /// Writes the head. Throws Error(Internal) where the library takes no such format.
  FlacEncoder(const SoundFormat& format, Write write);
  ~FlacEncoder();
  FlacEncoder(const FlacEncoder&) = delete;
  FlacEncoder& operator=(const FlacEncoder&) = delete;

  /// samples: [sample_count][channels], 24 bits (kSampleBits). False once a write has failed.
  bool add(std::span<const std::int32_t> samples);
  /// The rest, and the length in the head. Idempotent.
  bool finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Reads a FLAC file, one from outside too, from front to back. What is damaged in it is left out, and so
/// seen in the numbers of the samples. One thread. Throws Error(UnreadableInput) naming the file.
class FlacReader {
 public:
  explicit FlacReader(const std::filesystem::path& file);
  ~FlacReader();
  FlacReader(const FlacReader&) = delete;
  FlacReader& operator=(const FlacReader&) = delete;

  const SoundFormat& format() const;
  struct Block {
    std::int64_t first = 0;             ///< number of its first sample in the file
    std::vector<std::int32_t> samples;  ///< [sample_count][channels], 24 bits
  };
  /// The next block, 65,535 samples at most; false at the end. The block's memory is reused.
  bool next(Block& block);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::sound
