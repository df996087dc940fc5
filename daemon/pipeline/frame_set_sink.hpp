#pragma once

#include <memory>

#include "facet/frame_set.hpp"

namespace facet::pipeline {

/// Where frame sets go: what makes meshes of them, the stream and takes by way of SetsOnStream, a test.
class FrameSetSink {
 public:
  FrameSetSink() = default;
  FrameSetSink(const FrameSetSink&) = delete;
  FrameSetSink& operator=(const FrameSetSink&) = delete;
  virtual ~FrameSetSink() = default;

  /// Called with every set, slots ascending, on the one thread that makes them (`facet-sets`, or whoever
  /// reads a take). Must not throw; may block only where nothing may be lost (recorded sources). May keep the
  /// set as long as it likes.
  virtual void deliver(std::shared_ptr<const FrameSet> set) = 0;
};

}  // namespace facet::pipeline
