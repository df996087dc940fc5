#pragma once

#include <optional>
#include <vector>

#include "facet/messages.hpp"
#include "pipeline/progress.hpp"
#include "pipeline/status.hpp"

namespace facet::pipeline {

/// What the daemon runs. Life: construct -> start -> (ends by itself, or request_stop) -> stop -> destroy.
/// Sinks outlive the pipeline and are called until stop returns.
class Pipeline {
 public:
  Pipeline() = default;
  Pipeline(const Pipeline&) = delete;
  Pipeline& operator=(const Pipeline&) = delete;
  virtual ~Pipeline() = default;

  virtual void start() = 0;

  /// First phase of stopping: no thread begins another frame. Any thread, returns at once, idempotent.
  virtual void request_stop() = 0;
  /// Second phase: waits for the frames in the stages. Idempotent; the destructor calls both.
  virtual void stop() = 0;
  /// Whether every thread has done its last work, so that stop will not block. Any thread.
  virtual bool finished() const = 0;

  /// Any thread; takes a lock that is held for copying a few kilobytes at most.
  virtual PipelineStatus status() const = 0;

  /// The thread that was silent for the longest time; none before start and once all have ended. Waits of one
  /// thread for another are not silence. Any thread.
  virtual std::optional<Progress::Silence> longest_silence() const = 0;

  /// Identity and focal length are estimated anew from the next good frames. Any thread. Throws Error(Usage)
  /// where the pipeline makes no meshes.
  virtual void reset_identity() = 0;

  /// As CoarseStage::burst, of one live camera. Any thread.
  virtual void burst() {}

  /// What happened since the last call, for the log. Any thread.
  virtual std::vector<Messages::Message> take_messages() = 0;
};

}  // namespace facet::pipeline
