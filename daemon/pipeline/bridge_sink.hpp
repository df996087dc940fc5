#pragma once

#include <atomic>
#include <utility>

#include "avatar/bridge.hpp"
#include "pipeline/mesh_sink.hpp"

namespace facet::pipeline {

/// Hands frames to programs that move avatars, unless something else is shown there; never blocks.
class BridgeSink final : public MeshSink {
 public:
  /// bridge: outlives the sink.
  explicit BridgeSink(avatar::Bridge& bridge) : bridge_(bridge) {}
  /// While held, too: whoever records the live face gets its values.
  void complete(mesh::MeshFrame& frame) override { bridge_.complete(frame); }
  void deliver(std::shared_ptr<const mesh::MeshFrame> frame) override {
    if (!held_) {
      bridge_.publish(std::move(frame));
    }
  }

  /// While held, frames of the pipeline are let go unseen. Any thread.
  void hold(bool held) { held_ = held; }

 private:
  avatar::Bridge& bridge_;
  std::atomic<bool> held_{false};
};

}  // namespace facet::pipeline
