#include "pipeline/frame_pool.hpp"

#include <utility>

namespace facet::pipeline {

FramePool::FramePool() : shelf_(std::make_shared<Shelf>()) {}

std::shared_ptr<mesh::MeshFrame> FramePool::take() {
  std::unique_ptr<mesh::MeshFrame> frame;
  {
    const std::lock_guard lock(shelf_->mutex);
    if (!shelf_->frames.empty()) {
      frame = std::move(shelf_->frames.back());
      shelf_->frames.pop_back();
    }
  }
  if (frame == nullptr) {
    frame = std::make_unique<mesh::MeshFrame>();
  }
  return {frame.release(), [shelf = shelf_](mesh::MeshFrame* used) {
            std::unique_ptr<mesh::MeshFrame> back(used);
            clear(*back);
            const std::lock_guard lock(shelf->mutex);
            shelf->frames.push_back(std::move(back));
          }};
}

void clear(mesh::MeshFrame& frame) {
  mesh::MeshFrame empty;
  empty.degraded_reason = std::move(frame.degraded_reason);
  empty.expression = std::move(frame.expression);
  empty.landmarks_px = std::move(frame.landmarks_px);
  empty.displacements_mm = std::move(frame.displacements_mm);
  empty.confidence = std::move(frame.confidence);
  empty.degraded_reason.clear();
  empty.expression.clear();
  empty.landmarks_px.clear();
  empty.displacements_mm.clear();
  empty.confidence.clear();
  empty.control_vertices_mm.swap(frame.control_vertices_mm);
  frame = std::move(empty);
}

}  // namespace facet::pipeline
