#pragma once

#include <utility>

#include "avatar/bridge.hpp"
#include "pipeline/mesh_sink.hpp"

namespace facet::pipeline {

/// Hands frames to programs that move avatars; never blocks.
class BridgeSink final : public MeshSink {
 public:
  /// bridge: outlives the sink; null where none is configured.
  explicit BridgeSink(avatar::Bridge* bridge) : bridge_(bridge) {}
  void deliver(std::shared_ptr<const mesh::MeshFrame> frame) override {
    if (bridge_ != nullptr) {
      bridge_->publish(std::move(frame));
    }
  }

 private:
  avatar::Bridge* bridge_;
};

}  // namespace facet::pipeline
