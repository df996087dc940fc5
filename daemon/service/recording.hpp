#pragma once

#include <atomic>
#include <optional>
#include <string>

#include "facet/mutex.hpp"
#include "pipeline/take_sink.hpp"
#include "service/errands.hpp"
#include "service/log.hpp"
#include "service/sound_desk.hpp"
#include "service/take_index.hpp"
#include "take/recorder.hpp"

namespace facet::service {

/// The takes that the daemon records. They are begun and ended on a thread of their own, `facet-record`, as
/// both wait for the disk, which may take its time; the loop asks and looks.
class Recording {
 public:
  /// All outlive this object. Begin and end of a take are logged, and told to the index. beside: what stands
  /// beside its frames.
  Recording(pipeline::TakeSink& sink, SoundDesk& beside, TakeIndex& index, const Log& log);

  void start() { errands_.start(); }
  /// The thread on which begin and stop may be called.
  Errands& errands() { return errands_; }

  /// Begins a take, in the place of one that ended by itself; throws what pipeline::TakeSink::begin throws.
  /// On errands().
  void begin(take::TakeRecorderConfig config);
  /// Ends it as asked for. Throws Error(Usage) where nothing is recorded, with what became of the last. On
  /// errands().
  take::RecorderStatus stop();

  /// No more frames come: the take ends with this reason, as soon as the disk lets it, and so does one that
  /// is begun later. Any thread, returns at once.
  void end(const std::string& reason);
  /// Ends a take that has failed. With every round of the loop.
  void look_after();

  /// Of the take that is recorded, or of the last one where that ended by itself and no other has begun. Any
  /// thread, never waits.
  std::optional<take::RecorderStatus> status() const;

  /// First phase of the daemon's end: as end(), and nothing begins any more. Any thread.
  void request_stop(const std::string& reason);
  /// All that was to be written is written.
  bool finished() const;
  /// Second phase; only when finished(), or it waits for the disk.
  void finish();

 private:
  void close();
  std::optional<take::RecorderStatus> end_take(std::string reason);
  void log(const take::RecorderStatus& take) const;

  pipeline::TakeSink& sink_;
  SoundDesk& beside_;
  TakeIndex& index_;
  const Log& log_;
  mutable Mutex mutex_;  ///< held for copies alone
  /// That ended by itself, until the next begins.
  std::optional<take::RecorderStatus> last_ FACET_GUARDED_BY(mutex_);
  std::optional<std::string> end_reason_ FACET_GUARDED_BY(mutex_);  ///< no more frames come
  std::atomic<bool> closing_{false};                                ///< an errand will end the take
  Errands errands_{"facet-record"};
};

}  // namespace facet::service
