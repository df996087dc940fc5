#pragma once

#include <cstdint>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

#include "facet/clock.hpp"
#include "service/log.hpp"
#include "sound/capture.hpp"
#include "take/recorder.hpp"

namespace facet::service {

/// What stands beside the frames of a take that is recorded live: its timecode, and its sound where there is
/// a sound input. Whatever is wrong with the sound, the take goes on without and says so.
class SoundDesk {
 public:
  /// Borrows the log. source: null: that of config.device.
  SoundDesk(const sound::SoundConfig& config, const Log& log,
            std::unique_ptr<sound::SoundSource> source = nullptr);
  ~SoundDesk();
  SoundDesk(const SoundDesk&) = delete;
  SoundDesk& operator=(const SoundDesk&) = delete;

  /// Throws std::system_error where there is no thread to be had.
  void start();
  void look_after();      ///< with every round of the loop: what has changed is logged
  void request_stop();    ///< first phase; any thread
  bool finished() const;  ///< its threads have ended
  void stop();            ///< second phase

  /// A take of a live source is about to begin: its recorder is to ask for what stands beside (more_meta),
  /// and its sound begins. One thread at a time, as end and cancel; waits for the disk.
  void begin(take::TakeRecorderConfig& take);
  /// First phase of its end. Any thread, returns at once.
  void request_end();
  /// Second phase: the sound's file is closed.
  void end();
  /// It could not begin after all: nothing of it is left.
  void cancel();

  /// "HH:MM:SS:FF" of now: that of the timecode's input, else the time of day (UTC), at 30 frames a second.
  std::string timecode_now() const;
  /// As `sound` of the status; null where there is no sound input. Any thread, never waits.
  nlohmann::json status() const;

 private:
  take::MetaEntries beside(std::int64_t begun_ns, std::int64_t utc_minus_monotonic_ns) const;

  const Log& log_;
  std::string device_;
  std::optional<sound::SoundCapture> capture_;       ///< none without a sound input
  std::optional<std::filesystem::path> file_;        ///< of the take that is recorded
  sound::SoundState seen_ = sound::SoundState::Off;  ///< last, as the reason
  std::string seen_reason_;
  Clock::time_point seen_since_;
  sound::SoundState told_state_ = sound::SoundState::Off;
  std::string told_reason_;
};

}  // namespace facet::service
