#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "sound/sound_source.hpp"
#include "take/take_time.hpp"

namespace facet::sound {

struct SoundConfig {
  std::string device;  ///< as AlsaSource has it; empty: no sound
  int rate_hz = 48000;
  int channels = 1;          ///< that are taken of the device
  int timecode_channel = 0;  ///< of them, from 1, whose LTC is followed; 0: none
  bool record = true;        ///< the others beside takes; that one where it is alone
};

enum class SoundState {
  Off,      ///< not started
  Absent,   ///< the device can't be opened, or is gone; it is looked for every two seconds
  Running,  ///< samples come
};
const char* to_string(SoundState state);

struct SoundStatus {
  SoundState state = SoundState::Off;
  std::string reason;           ///< why Absent
  double rate_hz = 0;           ///< samples a second of CLOCK_MONOTONIC, as measured; 0 before
  double peak_dbfs = -200;      ///< of the last second or two, the loudest channel that is recorded
  std::uint64_t breaks = 0;     ///< times that samples were lost
  std::int64_t lost = 0;        ///< samples of silence in their place
  take::TakeTimecode timecode;  ///< of the last seconds; TimecodeSource::None: no LTC is heard
};

/// The sound of one device: taken all the time by the thread `facet-sound`, which knows when each sample was
/// taken (SoundClock), follows the timecode of one channel, and keeps the last two seconds, so that a take's
/// sound begins before its first frame. Samples are numbered on through everything: where some are lost, or
/// the device is away for up to ten minutes, silence as long takes their place. Frames wait for nothing here.
///
/// Life: construct -> start -> (begin_take -> end_take) ... -> request_stop -> stop.
class SoundCapture {
 public:
  SoundCapture(const SoundConfig& config, std::unique_ptr<SoundSource> source);
  ~SoundCapture();
  SoundCapture(const SoundCapture&) = delete;
  SoundCapture& operator=(const SoundCapture&) = delete;

  /// Throws std::system_error where there is no thread to be had.
  void start();
  void request_stop();    ///< first phase; any thread
  bool finished() const;  ///< its threads have ended, or never began
  void stop();            ///< second phase; ends a take

  SoundStatus status() const;  ///< any thread, never waits
  /// What was followed since then, CLOCK_MONOTONIC. Any thread, never waits.
  take::TakeTimecode timecode(std::int64_t since_ns) const;

  /// Begins the file with the last two seconds. Waits for the disk; one thread at a time, as end_take. False
  /// where nothing is to be recorded (SoundConfig::record). Throws Error(Unavailable) where there is no sound
  /// now, Error(Storage) where the file can't be made.
  bool begin_take(const std::filesystem::path& file, std::uint64_t disk_reserve_bytes);
  /// Of the file that is written, as it is now; of the last one after end_take. Any thread, never waits.
  take::TakeSound take_sound() const;
  /// First phase of a take's end: nothing more goes into its file. Any thread, returns at once.
  void request_take_end();
  /// Second phase: the file is closed. Nothing happens where nothing was begun.
  take::TakeSound end_take();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::sound
