#pragma once

#include <chrono>
#include <cstdint>

#include "capture/frame_set_matcher.hpp"
#include "facet/mutex.hpp"

namespace facet::capture {

/// FrameSetMatcher for many threads: the trigger's reader tells what was fired, each camera's thread pushes
/// its frames, one consumer takes the sets. Nobody but the consumer waits: the lock is held for the matching,
/// which allocates nothing. Where the consumer is slow the oldest sets are dropped and counted. Holds at most
/// open_sets + 8 frames of every camera, which its buffer pool must have beside the consumer's.
class FrameSetAssembler {
 public:
  /// Throws Error(Usage) for a configuration that can't be.
  explicit FrameSetAssembler(const CaptureConfig& config) : matcher_(config) {}

  /// From TriggerEvent::Kind::Fired: slot and actual time.
  void fired(std::uint64_t slot, std::int64_t fired_ns);
  /// Frames of one camera come from one thread.
  void push(std::size_t camera, Frame frame);
  /// See FrameSetMatcher.
  void set_streaming(std::size_t camera, bool streaming);

  enum class Outcome { Delivered, Timeout, Closed };
  /// Waits for the next set, `timeout` at most; what `out` held is released first. The consumer's thread.
  Outcome next(FrameSet& out, std::chrono::milliseconds timeout);

  /// Ends the waiting: every later next says Closed. Any thread; idempotent.
  void close();

  CaptureStatistics statistics() const;  ///< any thread

 private:
  mutable Mutex mutex_;
  Condition changed_;
  FrameSetMatcher matcher_ FACET_GUARDED_BY(mutex_);
  bool closed_ FACET_GUARDED_BY(mutex_) = false;
};

}  // namespace facet::capture
