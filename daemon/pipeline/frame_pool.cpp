#include "pipeline/frame_pool.hpp"

#include <algorithm>
#include <utility>

namespace facet::pipeline {

void clear(mesh::MeshFrame& frame) {
  mesh::MeshFrame empty;
  empty.degraded_reason = std::move(frame.degraded_reason);
  empty.expression = std::move(frame.expression);
  empty.expression_confidence = std::move(frame.expression_confidence);
  empty.avatar_values = std::move(frame.avatar_values);
  empty.model_weights = std::move(frame.model_weights);
  empty.landmarks_px = std::move(frame.landmarks_px);
  empty.displacements_mm = std::move(frame.displacements_mm);
  empty.confidence = std::move(frame.confidence);
  empty.degraded_reason.clear();
  empty.expression.clear();
  empty.expression_confidence.clear();
  empty.avatar_values.clear();
  empty.model_weights.clear();
  empty.landmarks_px.clear();
  empty.displacements_mm.clear();
  empty.confidence.clear();
  empty.control_vertices_mm.swap(frame.control_vertices_mm);
  frame = std::move(empty);
}

void clear(FrameSet& set) {
  FrameSet empty;
  std::fill(set.frames.begin(), set.frames.end(), Frame{});
  empty.frames = std::move(set.frames);
  set = std::move(empty);
}

}  // namespace facet::pipeline
