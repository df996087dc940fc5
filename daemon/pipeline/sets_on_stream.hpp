#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "capture/frame_set.hpp"
#include "facet/clock.hpp"
#include "pipeline/frame_pool.hpp"
#include "pipeline/frame_set_sink.hpp"
#include "pipeline/mesh_sink.hpp"

namespace facet::pipeline {

/// Frame sets for whom takes frames alone, the stream and takes: a frame without a mesh for each.
/// MeshFrame::sequence is the slot, timestamp_ns the time at which it was fired; degraded where a picture is
/// missing. The sinks outlive this one.
class SetsOnStream final : public FrameSetSink {
 public:
  explicit SetsOnStream(std::vector<MeshSink*> sinks) : sinks_(std::move(sinks)) {}
  void deliver(std::shared_ptr<const FrameSet> set) override {
    const std::shared_ptr<mesh::MeshFrame> frame = frames_.take();
    frame->sequence = set->slot;
    frame->timestamp_ns = set->trigger_ns;
    frame->media_time_ns = set->media_time_ns;
    frame->control_vertices_mm.resize(3, 0);
    frame->degraded = !set->complete();
    frame->degraded_reason = capture::missing_pictures(*set);
    frame->stage_ms.latency_ms = static_cast<float>(Clock::now_ns() - set->trigger_ns) * 1e-6F;
    frame->images = std::move(set);
    for (MeshSink* sink : sinks_) {
      sink->complete(*frame);
    }
    for (MeshSink* sink : sinks_) {
      sink->deliver(frame);
    }
  }

 private:
  std::vector<MeshSink*> sinks_;
  FramePool frames_;
};

}  // namespace facet::pipeline
