#include "pipeline/pipeline_board.hpp"

#include "facet/clock.hpp"
#include "facet/mutex.hpp"

namespace facet::pipeline {

void PipelineBoard::fail(ErrorKind kind, const std::string& what) {
  const Lock lock(mutex_);
  if (shown_.state != PipelineState::Failed) {
    shown_.state = PipelineState::Failed;
    shown_.failure_kind = kind;
    shown_.reason = what;
  }
}

void PipelineBoard::set_state(PipelineState state) {
  const Lock lock(mutex_);
  if (shown_.state != PipelineState::Failed && shown_.state != PipelineState::Ended &&
      shown_.state != PipelineState::Stopped) {
    shown_.state = state;
  }
}

void PipelineBoard::count_degraded(const std::string& reason) {
  ++shown_.degraded_frames;
  shown_.degraded_reason = reason;
}

void PipelineBoard::count(const mesh::MeshFrame& frame, bool has_face) {
  const Lock lock(mutex_);
  ++shown_.processed;
  shown_.tracking = frame.state;
  shown_.mesh_frames += frame.state == mesh::TrackingState::Tracking ? 1 : 0;
  shown_.face_frames += has_face ? 1 : 0;
  shown_.refined_frames += frame.displacements_mm.empty() ? 0 : 1;
  if (frame.degraded) {
    count_degraded(frame.degraded_reason);
  }
  figures_.add(frame, Clock::now());
}

void PipelineBoard::count(const mesh::StageTimes& times, const std::string& missing) {
  const Lock lock(mutex_);
  ++shown_.processed;
  if (!missing.empty()) {
    count_degraded(missing);
  }
  figures_.add(times, Clock::now());
}

PipelineStatus PipelineBoard::status() const {
  const Lock lock(mutex_);
  PipelineStatus status = shown_;
  figures_.fill(status);
  return status;
}

}  // namespace facet::pipeline
