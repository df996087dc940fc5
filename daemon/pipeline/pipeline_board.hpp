#pragma once

#include <string>

#include "facet/mutex.hpp"
#include "pipeline/figures.hpp"
#include "pipeline/status.hpp"

namespace facet::pipeline {

/// What a pipeline shows of itself: state, reason, counters and figures. Its threads write, whoever asks
/// reads. Any thread; its lock is held for copying a few kilobytes at most.
class PipelineBoard {
 public:
  /// The first failure is what is shown.
  void fail(ErrorKind kind, const std::string& what);
  /// The end is final: a thread that is late does not overwrite it.
  void set_state(PipelineState state);

  /// change(PipelineStatus&): of what is counted nowhere below.
  template <typename Change>
  void change(const Change& change) {
    const Lock lock(mutex_);
    change(shown_);
  }

  /// Counts a frame that the sinks have. has_face: it counts among PipelineStatus::face_frames.
  void count(const mesh::MeshFrame& frame, bool has_face);
  /// Counts a frame set that the sinks have. missing: capture::missing_pictures.
  void count(const mesh::StageTimes& times, const std::string& missing);

  /// With the moving figures.
  PipelineStatus status() const;

 private:
  void count_degraded(const std::string& reason) FACET_REQUIRES(mutex_);

  mutable Mutex mutex_;
  PipelineStatus shown_ FACET_GUARDED_BY(mutex_);
  MovingFigures figures_ FACET_GUARDED_BY(mutex_);
};

}  // namespace facet::pipeline
