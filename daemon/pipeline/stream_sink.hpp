#pragma once

#include <atomic>
#include <utility>

#include "pipeline/mesh_sink.hpp"
#include "stream/server.hpp"

namespace facet::pipeline {

/// Hands frames to the stream's readers, unless something else is shown there; never blocks.
class StreamSink final : public MeshSink {
 public:
  /// The server outlives the sink.
  explicit StreamSink(stream::StreamServer& server) : server_(server) {}
  void deliver(std::shared_ptr<const mesh::MeshFrame> frame) override {
    if (!held_) {
      server_.publish(std::move(frame));
    }
  }

  /// While held, frames are let go unseen. Any thread.
  void hold(bool held) { held_ = held; }

 private:
  stream::StreamServer& server_;
  std::atomic<bool> held_{false};
};

}  // namespace facet::pipeline
