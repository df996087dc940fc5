#pragma once

#include <memory>
#include <mutex>
#include <optional>

#include "pipeline/mesh_sink.hpp"
#include "take/recorder.hpp"

namespace facet::pipeline {

/// Records frames while a take is wanted, one take at a time; of a face whose identity is still being
/// estimated without the provisional mesh: a take has one topology for one person. With take::WhenFull::Wait
/// deliver blocks while the disk is slower than the frames.
class TakeSink final : public MeshSink {
 public:
  void deliver(std::shared_ptr<const mesh::MeshFrame> frame) override;

  /// Begins a take with the next frame. Throws Error(Usage) where one is being recorded, and what
  /// take::TakeRecorder throws. Any thread.
  void begin(const take::TakeRecorderConfig& config);

  /// First phase of the end: the take gets no more frames. Any thread, returns at once.
  void request_end();
  /// Second phase: what is queued is written. Returns what became of the take, nothing where none was being
  /// recorded. One thread at a time.
  std::optional<take::RecorderStatus> end();

  /// Of the take that is being recorded. Any thread.
  std::optional<take::RecorderStatus> status() const;

 private:
  std::shared_ptr<take::TakeRecorder> current() const;

  mutable std::mutex mutex_;                      ///< held for a pointer's copy only
  std::shared_ptr<take::TakeRecorder> recorder_;  ///< guarded by mutex_; null: nothing is recorded
};

}  // namespace facet::pipeline
