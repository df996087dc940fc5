#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "sound/sound_source.hpp"

namespace facet::sound {

struct SoundFileConfig {
  std::filesystem::path file;  ///< must not exist yet
  SoundFormat format;
  std::uint64_t disk_reserve_bytes = 0;  ///< it ends while this much of the disk is still free
};

struct SoundFileStatus {
  std::int64_t samples = 0;  ///< of each channel, taken so far
  std::int64_t lost = 0;     ///< of these: silence, as the disk was too slow
  std::string reason;        ///< empty, or why it ended by itself
};

/// Writes one FLAC file. The thread `facet-flac` encodes, waits for the disk, and syncs what it wrote every
/// second: that much, and what waits, is lost where power is cut; what is there can be read.
class SoundFile {
 public:
  /// Makes the file. Throws Error(Storage).
  explicit SoundFile(const SoundFileConfig& config);
  ~SoundFile();
  SoundFile(const SoundFile&) = delete;
  SoundFile& operator=(const SoundFile&) = delete;

  /// Throws std::system_error where there is no thread to be had.
  void start();
  /// samples: [sample_count][channels], 24 bits. Any thread, never waits: where twenty seconds wait for the
  /// disk, silence is written in their place and counted.
  void add(std::vector<std::int32_t> samples);
  /// So many samples of silence.
  void add_silence(std::int64_t samples);
  /// Nothing more comes; reason: why, where nobody asked for it. Any thread, returns at once.
  void request_stop(std::string reason = {});
  /// All is on the disk, and the file closed, when it returns.
  SoundFileStatus stop();
  bool ended() const;              ///< the file is closed, or was never begun; any thread
  SoundFileStatus status() const;  ///< any thread

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::sound
