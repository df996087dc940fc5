#pragma once

#include <memory>
#include <optional>
#include <string>

#include "facet/mutex.hpp"
#include "pipeline/mesh_sink.hpp"
#include "take/recorder.hpp"

namespace facet::pipeline {

/// Records frames while a take is wanted, one take at a time; of a face whose identity is still being
/// estimated without the provisional mesh: a take has one topology for one person. With take::WhenFull::Wait
/// deliver blocks while the disk is slower than the frames.
///
/// begin and end wait for the disk, which may take many seconds, and belong to one thread at a time. All
/// else may be called by any thread meanwhile, and waits for neither of them.
class TakeSink final : public MeshSink {
 public:
  void deliver(std::shared_ptr<const mesh::MeshFrame> frame) override;
  /// While something is recorded.
  bool wants_one_mesh() const override { return current() != nullptr; }

  /// Begins a take with the next frame. Throws Error(Usage) where one is being recorded, and what
  /// take::TakeRecorder throws.
  void begin(const take::TakeRecorderConfig& config);

  /// First phase of the end: the take, also one that is just being begun, gets no more frames and is closed.
  /// reason: why, for the take's `end_reason`; empty where it was asked for. That of the first call stays.
  void request_end(std::string reason);
  /// True where nothing is recorded, or all of what is was written after request_end.
  bool ended() const;
  /// Second phase: waits until what is queued is written. Returns what became of the take, nothing where none
  /// was being recorded.
  std::optional<take::RecorderStatus> end(std::string reason);

  /// Of the take that is being recorded.
  std::optional<take::RecorderStatus> status() const;

 private:
  std::shared_ptr<take::TakeRecorder> current() const;

  mutable Mutex mutex_;                                                    ///< held for a pointer's copy only
  std::shared_ptr<take::TakeRecorder> recorder_ FACET_GUARDED_BY(mutex_);  ///< null: nothing is recorded
  bool beginning_ FACET_GUARDED_BY(mutex_) = false;                        ///< a recorder is being made
  std::optional<std::string> end_wanted_ FACET_GUARDED_BY(mutex_);         ///< of that one
};

}  // namespace facet::pipeline
