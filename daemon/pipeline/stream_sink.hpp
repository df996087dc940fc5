#pragma once

#include <utility>

#include "pipeline/mesh_sink.hpp"
#include "stream/server.hpp"

namespace facet::pipeline {

/// Hands frames to the stream's readers; never blocks.
class StreamSink final : public MeshSink {
 public:
  /// The server outlives the sink.
  explicit StreamSink(stream::StreamServer& server) : server_(server) {}
  void deliver(std::shared_ptr<const mesh::MeshFrame> frame) override { server_.publish(std::move(frame)); }

 private:
  stream::StreamServer& server_;
};

}  // namespace facet::pipeline
