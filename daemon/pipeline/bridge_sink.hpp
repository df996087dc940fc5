#pragma once

#include <atomic>
#include <utility>

#include "avatar/bridge.hpp"
#include "pipeline/mesh_sink.hpp"

namespace facet::pipeline {

/// Hands frames to programs that move avatars, unless something else is shown there; never blocks.
class BridgeSink final : public MeshSink {
 public:
  /// bridge: outlives the sink; null where none is configured.
  explicit BridgeSink(avatar::Bridge* bridge) : bridge_(bridge) {}
  void deliver(std::shared_ptr<const mesh::MeshFrame> frame) override {
    if (!held_) {
      show(std::move(frame));
    }
  }
  /// What is shown in the live face's place. Any thread.
  void show(std::shared_ptr<const mesh::MeshFrame> frame) {
    if (bridge_ != nullptr) {
      bridge_->publish(std::move(frame));
    }
  }

  /// While held, frames of the pipeline are let go unseen. Any thread.
  void hold(bool held) { held_ = held; }

 private:
  avatar::Bridge* bridge_;
  std::atomic<bool> held_{false};
};

}  // namespace facet::pipeline
