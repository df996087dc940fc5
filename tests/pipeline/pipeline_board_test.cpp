#include "pipeline/pipeline_board.hpp"

#include <gtest/gtest.h>

namespace facet::pipeline {
namespace {

TEST(PipelineBoard, TheFirstFailureStaysAndTheEndIsFinal) {
  PipelineBoard board;
  EXPECT_EQ(board.status().state, PipelineState::Idle);
  board.set_state(PipelineState::Running);
  EXPECT_EQ(board.status().state, PipelineState::Running);
  board.fail(ErrorKind::NoDevice, "the first");
  board.fail(ErrorKind::Usage, "the second");
  board.set_state(PipelineState::Running);
  board.set_state(PipelineState::Stopped);
  EXPECT_EQ(board.status().state, PipelineState::Failed);
  EXPECT_EQ(board.status().failure_kind, ErrorKind::NoDevice);
  EXPECT_EQ(board.status().reason, "the first");

  for (const PipelineState end : {PipelineState::Ended, PipelineState::Stopped}) {
    PipelineBoard other;
    other.set_state(end);
    other.set_state(PipelineState::Running);
    EXPECT_EQ(other.status().state, end);
    other.fail(ErrorKind::Internal, "late");
    EXPECT_EQ(other.status().state, PipelineState::Failed) << "a failure is never hidden";
  }
}

TEST(PipelineBoard, CountsFramesAndSets) {
  PipelineBoard board;
  mesh::MeshFrame frame;
  frame.state = mesh::TrackingState::Tracking;
  frame.displacements_mm = {0.5F};
  frame.photometric_rms = 0.25F;
  frame.stage_ms.fit_ms = 4;
  board.count(frame, true);
  frame.state = mesh::TrackingState::Lost;
  frame.displacements_mm.clear();
  frame.degraded = true;
  frame.degraded_reason = "no light";
  board.count(frame, false);
  PipelineStatus status = board.status();
  EXPECT_EQ(status.processed, 2U);
  EXPECT_EQ(status.mesh_frames, 1U);
  EXPECT_EQ(status.face_frames, 1U);
  EXPECT_EQ(status.refined_frames, 1U);
  EXPECT_EQ(status.degraded_frames, 1U);
  EXPECT_EQ(status.degraded_reason, "no light");
  EXPECT_EQ(status.tracking, mesh::TrackingState::Lost);
  EXPECT_FLOAT_EQ(status.photometric_rms, 0.25F);
  EXPECT_GT(status.frames_per_second, 0);

  board.count(frame.stage_ms, "");
  board.count(frame.stage_ms, "no picture of camera top");
  status = board.status();
  EXPECT_EQ(status.processed, 4U);
  EXPECT_EQ(status.mesh_frames, 1U) << "a set is no mesh";
  EXPECT_EQ(status.degraded_frames, 2U);
  EXPECT_EQ(status.degraded_reason, "no picture of camera top");
}

}  // namespace
}  // namespace facet::pipeline
