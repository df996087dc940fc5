#include "pipeline/shading.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <set>
#include <thread>
#include <utility>

#include "face/person_model.hpp"
#include "pipeline/bounded_queue.hpp"
#include "scripted_stages.hpp"

namespace facet::pipeline {
namespace {

using mesh::TrackingState;
using refine::RefineOutcome;
using test::CollectingSink;
using test::Script;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

ShadingPipeline::Options options() {
  ShadingPipeline::Options options;
  options.hierarchy.min_edge_px = 4;
  options.pauses.first = std::chrono::milliseconds(1);
  options.pauses.longest = std::chrono::milliseconds(2);
  return options;
}

/// A pipeline of scripted stages with one sink.
class Shading : public ::testing::Test {
 protected:
  ShadingPipeline& make(const ShadingPipeline::Options& given = options()) {
    pipeline_ = std::make_unique<ShadingPipeline>(script_.stages(), given, std::vector<MeshSink*>{&sink_});
    return *pipeline_;
  }
  /// Runs until the pipeline ends by itself.
  PipelineStatus run(const ShadingPipeline::Options& given = options()) {
    make(given).start();
    await_end();
    pipeline_->stop();
    return pipeline_->status();
  }
  void await_end() const {
    while (!pipeline_->finished()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }

  Script script_;
  CollectingSink sink_;
  std::unique_ptr<ShadingPipeline> pipeline_;
};

TEST_F(Shading, ARecordingLosesNoFrame) {
  script_.frame_count = 50;
  const PipelineStatus status = run();
  EXPECT_EQ(status.state, PipelineState::Ended);
  EXPECT_EQ(status.captured, 50U);
  EXPECT_EQ(status.dropped, 0U);
  EXPECT_EQ(status.processed, 50U);
  EXPECT_EQ(status.mesh_frames, 50U);
  EXPECT_EQ(status.refined_frames, 50U);
  EXPECT_EQ(status.degraded_frames, 0U);
  EXPECT_EQ(status.subjects, 1U);
  EXPECT_EQ(status.device, "scripted GPU");
  EXPECT_FLOAT_EQ(status.photometric_rms, 0.02F);
  EXPECT_GT(status.frames_per_second, 0);
  EXPECT_TRUE(script_.camera_stopped);
  const auto frames = sink_.frames();
  ASSERT_EQ(frames.size(), 50U);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const mesh::MeshFrame& frame = *frames[i];
    EXPECT_EQ(frame.sequence, i);
    EXPECT_TRUE(frame.model_weights.empty()) << "nothing was read";
    EXPECT_EQ(frame.timestamp_ns, static_cast<std::int64_t>(i) * 33'000'000);
    EXPECT_EQ(frame.control_vertices_mm.cols(), script_.model->vertex_count());
    EXPECT_EQ(frame.subject, frames[0]->subject);
    EXPECT_EQ(frame.displacements_mm.size(),
              static_cast<std::size_t>(frame.subject->hierarchy->finest().vertex_count));
    EXPECT_EQ(frame.landmarks_px.size(), 468U);
    EXPECT_GT(frame.stage_ms.latency_ms, 0);
    EXPECT_FLOAT_EQ(frame.stage_ms.displacement_ms, 3);
  }
}

TEST_F(Shading, PicturesGoWithTheFramesWhereTheyAreWanted) {
  script_.frame_count = 3;
  run();
  EXPECT_EQ(sink_.frames().back()->images, nullptr);
  ShadingPipeline::Options with_pictures = options();
  with_pictures.hand_on_pictures = true;
  run(with_pictures);
  const auto frames = sink_.frames();
  for (std::size_t i = frames.size() - 3; i < frames.size(); ++i) {
    const FrameSet* set = frames[i]->images.get();
    ASSERT_NE(set, nullptr);
    ASSERT_EQ(set->frames.size(), 1U);
    EXPECT_FALSE(set->frames.front().empty());
    EXPECT_EQ(set->slot, frames[i]->sequence);
    ASSERT_NE(set->camera_names, nullptr);
    EXPECT_EQ(set->camera_names->size(), 1U);
  }
}

TEST_F(Shading, ALiveSourceDropsOldFramesAndCountsThem) {
  script_.live = true;
  script_.frame_count = 40;
  script_.tracker_gate.set(false);
  make().start();
  // The tracker holds the first frame that it got; the camera goes on to its end.
  while (!script_.camera_stopped) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  script_.tracker_gate.set(true);
  await_end();
  const PipelineStatus status = pipeline_->status();
  EXPECT_EQ(status.captured, 40U);
  EXPECT_EQ(status.processed + status.dropped, 40U);
  EXPECT_LE(status.processed, 3U) << "what the tracker held, and the newest";
  EXPECT_EQ(sink_.frames().back()->sequence, 39U) << "the newest wins";
}

TEST_F(Shading, OnlyALiveCamerasRateLimitsRefinement) {
  run();
  EXPECT_EQ(script_.time_limit_ms, 0);
}

TEST_F(Shading, WhatTheRateTakesIsSaidOnce) {
  script_.live = true;
  script_.frame_count = ~0ULL;
  script_.hurried = true;
  make().start();
  sink_.wait_for([](const mesh::MeshFrame&) { return true; });
  EXPECT_EQ(pipeline_->status().given_up, "scripted hurry");
  script_.hurried = false;
  // Frames that were refined before this line may still arrive, with any number that the camera dropped
  // between them.
  sink_.wait_for([this](const mesh::MeshFrame&) { return pipeline_->status().given_up.empty(); });
  EXPECT_EQ(pipeline_->status().given_up, "");
  pipeline_->stop();
  EXPECT_FLOAT_EQ(script_.time_limit_ms, 30) << "nine tenths of a frame at 30 Hz";
  std::vector<std::string> said;
  for (const Messages::Message& message : pipeline_->take_messages()) {
    if (message.text.starts_with("refinement")) {
      said.push_back(message.text);
    }
  }
  EXPECT_THAT(said, testing::ElementsAre("refinement: scripted hurry", "refinement: all levels again"));
}

TEST_F(Shading, FramesThatTheDriverSkippedCountAsDropped) {
  script_.frame_count = 10;
  script_.sequence_step = 3;
  EXPECT_EQ(run().dropped, 0U) << "what a recording leaves out was not there";
  script_.live = true;
  const PipelineStatus status = run();
  EXPECT_GE(status.dropped, 18U);
  EXPECT_EQ(status.processed + status.dropped, 28U);
}

TEST_F(Shading, TheTrackerWorksOnTheNextFrameWhileTheGpuIsBusy) {
  script_.frame_count = 3;
  script_.refiner_gate.set(false);
  script_.tracker_gate.set(true);
  std::atomic<bool> tracked_second{false};
  script_.state_of = [&](std::uint64_t sequence) {
    tracked_second = tracked_second || sequence == 1;
    return TrackingState::Tracking;
  };
  make().start();
  script_.refiner_gate.wait_for_visitor();
  while (!tracked_second) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_TRUE(sink_.frames().empty()) << "frame 0 is still at the GPU";
  script_.refiner_gate.set(true);
  await_end();
  EXPECT_EQ(sink_.frames().size(), 3U);
}

TEST_F(Shading, FramesWithoutAMeshAreHandedOutToo) {
  script_.state_of = [](std::uint64_t sequence) {
    return sequence < 3   ? TrackingState::Searching
           : sequence < 6 ? TrackingState::Acquiring
                          : TrackingState::Lost;
  };
  const PipelineStatus status = run();
  EXPECT_EQ(status.processed, 10U);
  EXPECT_EQ(status.mesh_frames, 0U);
  EXPECT_EQ(status.face_frames, 7U);
  EXPECT_EQ(status.subjects, 0U);
  for (const auto& frame : sink_.frames()) {
    EXPECT_EQ(frame->subject, nullptr);
    EXPECT_EQ(frame->control_vertices_mm.cols(), 0);
    EXPECT_TRUE(frame->expression.empty());
    EXPECT_FALSE(frame->degraded);
  }
}

TEST_F(Shading, AFaceThatIsNotKnownYetHasAProvisionalMesh) {
  script_.mesh_while_acquiring = true;
  script_.state_of = [](std::uint64_t sequence) {
    return sequence < 3 || sequence == 6 ? TrackingState::Acquiring : TrackingState::Tracking;
  };
  const PipelineStatus status = run();
  EXPECT_EQ(status.mesh_frames, 6U) << "provisional ones are not counted";
  EXPECT_EQ(status.subjects, 1U);
  EXPECT_EQ(status.refined_frames, 6U);
  const auto frames = sink_.frames();
  const auto& provisional = frames[0]->subject;
  ASSERT_NE(provisional, nullptr);
  EXPECT_EQ(provisional->hierarchy->levels.size(), 1U);
  EXPECT_EQ(provisional->identity, std::vector<float>(frames[3]->subject->identity.size(), 0.0F));
  EXPECT_NE(provisional->id, frames[3]->subject->id);
  EXPECT_NE(provisional->id, 0U);
  for (const std::size_t f : {0U, 1U, 2U, 6U}) {
    EXPECT_EQ(frames[f]->state, TrackingState::Acquiring);
    EXPECT_EQ(frames[f]->subject, provisional);
    EXPECT_EQ(frames[f]->control_vertices_mm.cols(), script_.model->vertex_count());
    EXPECT_EQ(frames[f]->expression.size(), provisional->expression_names.size());
    EXPECT_TRUE(frames[f]->displacements_mm.empty());
    EXPECT_FALSE(frames[f]->degraded);
  }
  EXPECT_EQ(frames[7]->subject, frames[3]->subject);
}

TEST_F(Shading, WhatIsReadOffAFaceGoesOutWithTheWeightsThatMakeItsMesh) {
  script_.read_values.assign(static_cast<std::size_t>(script_.model->expression_count()), 0.75F);
  script_.read_confidence.assign(script_.read_values.size(), 0.5F);
  run();
  ASSERT_FALSE(sink_.frames().empty());
  for (const auto& frame : sink_.frames()) {
    EXPECT_EQ(frame->expression, script_.read_values);
    EXPECT_EQ(frame->expression_confidence, script_.read_confidence);
    EXPECT_EQ(mesh::shape_weights(*frame), std::vector<float>(script_.read_values.size(), 0.25F));
  }
}

TEST_F(Shading, WhatWasLearnedAheadIsFollowedAndGoesWithTheMeshes) {
  const std::vector<float> identity(static_cast<std::size_t>(script_.model->identity_count()), 0.5F);
  Eigen::Matrix3Xd own = script_.model->contract_identity(identity).neutral_mm.cast<double>();
  own.row(0) *= 1.05;
  script_.learned.model =
      std::make_shared<const face::FaceModel>(face::person_model(*script_.model, identity, own, "learned"));
  script_.learned.note = "its own shape is followed";
  const PipelineStatus status = run();
  EXPECT_GT(status.refined_frames, 0U);
  const auto frames = sink_.frames();
  ASSERT_NE(frames.front()->subject, nullptr);
  EXPECT_LT((frames.front()->subject->neutral_mm - own.cast<float>()).cwiseAbs().maxCoeff(), 1e-4F);
  EXPECT_EQ(frames.front()->subject->identity, identity);
}

TEST_F(Shading, WhatIsLearnedMeanwhileIsFollowedFromThenOn) {
  const std::vector<float> identity(static_cast<std::size_t>(script_.model->identity_count()), 0.5F);
  Eigen::Matrix3Xd own = script_.model->contract_identity(identity).neutral_mm.cast<double>();
  own.row(0) *= 1.05;
  const auto learned =
      std::make_shared<face::FaceModel>(face::person_model(*script_.model, identity, own, "learned"));
  learned->skin.width = learned->skin.height = 2;
  learned->skin.texels_per_unit = 1;
  learned->skin.relief_mm.assign(4, 0);
  learned->skin.albedo.assign(12, 0.3F);
  script_.state_of = [&](std::uint64_t sequence) {  // on the tracker's thread
    if (sequence == 2) {
      auto solving = std::make_shared<LearningStatus>();
      solving->state = LearningStatus::State::Solving;
      script_.learned.learning = solving;
    } else if (sequence == 4) {
      script_.learned.model = learned;
      script_.learned.note = "its own shape is followed";
    }
    return TrackingState::Tracking;
  };
  script_.subject_of = [](std::uint64_t sequence) { return sequence < 4 ? 1U : 2U; };
  const PipelineStatus status = run();
  EXPECT_EQ(status.subjects, 2U);
  ASSERT_NE(status.learning, nullptr);
  EXPECT_EQ(status.learning->state, LearningStatus::State::Solving);
  const auto frames = sink_.frames();
  EXPECT_EQ(frames[3]->subject->neutral_mm.size(), 0);
  EXPECT_LT((frames[4]->subject->neutral_mm - own.cast<float>()).cwiseAbs().maxCoeff(), 1e-4F);
  int said = 0;
  for (const Messages::Message& message : pipeline_->take_messages()) {
    said += message.text == script_.learned.note ? 1 : 0;
  }
  EXPECT_EQ(said, 1);
  EXPECT_EQ(script_.known_shapes, (std::vector<bool>{false, true})) << "refinement knows whom it refines";
  EXPECT_EQ(script_.known_skins, (std::vector<bool>{false, true}));
}

/// A take keeps the mesh that it began with.
TEST_F(Shading, WhileASinkWantsOneMeshTheTrackerIsToldToKeepIt) {
  class Recording final : public MeshSink {
   public:
    void deliver(std::shared_ptr<const mesh::MeshFrame> /*frame*/) override {}
    bool wants_one_mesh() const override { return wants; }
    std::atomic<bool> wants{false};
  } recording;
  std::vector<bool> kept;
  script_.state_of = [&](std::uint64_t sequence) {  // on the tracker's thread
    kept.push_back(script_.keeps_model);
    recording.wants = sequence >= 2 && sequence < 5;  // from the next frame on
    return TrackingState::Tracking;
  };
  script_.frame_count = 8;
  ShadingPipeline pipeline(script_.stages(), options(), {&sink_, &recording});
  pipeline.start();
  while (!pipeline.finished()) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  pipeline.stop();
  EXPECT_EQ(kept, std::vector<bool>({false, false, false, true, true, true, false, false}));
}

TEST_F(Shading, ANewSubjectGetsItsOwnHierarchy) {
  script_.subject_of = [](std::uint64_t sequence) { return sequence < 4 ? 1U : 2U; };
  const PipelineStatus status = run();
  EXPECT_EQ(status.subjects, 2U);
  EXPECT_EQ(script_.subjects_set, 2);
  const auto frames = sink_.frames();
  EXPECT_EQ(frames[0]->subject, frames[3]->subject);
  EXPECT_EQ(frames[4]->subject, frames[9]->subject);
  EXPECT_NE(frames[0]->subject->id, frames[4]->subject->id);
  EXPECT_NE(frames[0]->subject->id, 0U);
}

TEST_F(Shading, DisplacementsOfBeforeAreForgottenWhenTheFaceComesBack) {
  script_.state_of = [](std::uint64_t sequence) {
    return sequence == 0                    ? TrackingState::Acquiring
           : sequence == 4 || sequence == 5 ? TrackingState::Lost
                                            : TrackingState::Tracking;
  };
  script_.subject_of = [](std::uint64_t sequence) { return sequence < 8 ? 1U : 2U; };
  const PipelineStatus status = run();
  EXPECT_EQ(status.refined_frames, 7U);
  EXPECT_THAT(script_.restarted_before, ElementsAre(6U)) << "a new subject starts anew by itself";
}

TEST_F(Shading, WithoutRefinementFramesAreCoarseAndSaySo) {
  script_.has_refiner = false;
  const PipelineStatus status = run();
  EXPECT_EQ(status.degraded_frames, 10U);
  EXPECT_EQ(status.degraded_reason, "refinement off");
  EXPECT_EQ(status.device, "");
  for (const auto& frame : sink_.frames()) {
    EXPECT_TRUE(frame->degraded);
    EXPECT_EQ(frame->degraded_reason, "refinement off");
    EXPECT_TRUE(frame->displacements_mm.empty());
    EXPECT_NE(frame->subject, nullptr) << "a coarse mesh is a mesh";
  }
}

TEST_F(Shading, ANumericalFailureCostsTheDetailOfOneFrame) {
  script_.outcome_of = [](std::uint64_t sequence) {
    return sequence == 4 ? RefineOutcome::NumericalFailure : RefineOutcome::Refined;
  };
  const PipelineStatus status = run();
  EXPECT_EQ(status.degraded_frames, 1U);
  EXPECT_EQ(status.refined_frames, 9U);
  const auto frames = sink_.frames();
  EXPECT_TRUE(frames[4]->degraded);
  EXPECT_EQ(frames[4]->degraded_reason, "scripted failure");
  EXPECT_TRUE(frames[4]->displacements_mm.empty());
  EXPECT_EQ(frames[4]->control_vertices_mm.cols(), script_.model->vertex_count());
  EXPECT_FALSE(frames[5]->degraded);
}

TEST_F(Shading, APictureTooLargeForTheDeviceGivesACoarseMesh) {
  script_.no_room_from = 7;
  const PipelineStatus status = run();
  EXPECT_EQ(status.state, PipelineState::Ended);
  EXPECT_EQ(status.mesh_frames, 10U);
  EXPECT_EQ(status.refined_frames, 7U);
  EXPECT_EQ(status.degraded_frames, 3U);
  EXPECT_THAT(status.degraded_reason,
              AllOf(HasSubstr("scripted GPU"), HasSubstr("too large"), HasSubstr("use a smaller picture")));
  int warnings = 0;
  for (const Messages::Message& message : pipeline_->take_messages()) {
    warnings += message.warning ? 1 : 0;
  }
  EXPECT_EQ(warnings, 1) << "said once, not with every frame";
}

TEST_F(Shading, ALostDeviceIsReopenedWhileFramesStayCoarse) {
  script_.live = true;
  script_.frame_count = ~0ULL;
  script_.failing_opens = 3;
  std::atomic<bool> lost{false};
  script_.outcome_of = [&](std::uint64_t sequence) {
    return sequence >= 3 && !lost.exchange(true) ? RefineOutcome::DeviceLost : RefineOutcome::Refined;
  };
  make().start();
  sink_.wait_for([](const mesh::MeshFrame& frame) { return frame.degraded; });
  sink_.wait_for(
      [&](const mesh::MeshFrame& frame) { return script_.opens == 4 && !frame.displacements_mm.empty(); });
  pipeline_->stop();
  EXPECT_EQ(script_.opens, 4);
  EXPECT_EQ(script_.subjects_set, 2) << "the reopened device knows the subject";
  const auto frames = sink_.frames();
  bool coarse_seen = false;
  for (const auto& frame : frames) {
    EXPECT_EQ(frame->degraded, frame->displacements_mm.empty());
    if (frame->degraded) {
      coarse_seen = true;
      EXPECT_THAT(frame->degraded_reason, HasSubstr("GPU lost"));
      EXPECT_THAT(frame->degraded_reason, HasSubstr("scripted failure"));
      EXPECT_EQ(frame->control_vertices_mm.cols(), script_.model->vertex_count());
    }
  }
  EXPECT_TRUE(coarse_seen);
  std::string said;
  for (const Messages::Message& message : pipeline_->take_messages()) {
    said += message.text + '\n';
  }
  EXPECT_THAT(said, HasSubstr("scripted GPU lost"));
  EXPECT_THAT(said, HasSubstr("cannot reopen the GPU: scripted: no device"));
  EXPECT_THAT(said, HasSubstr("scripted GPU is back"));
}

TEST_F(Shading, StopsWhileTheDeviceCannotBeReopened) {
  script_.live = true;
  script_.frame_count = ~0ULL;
  script_.failing_opens = 1'000'000;
  script_.outcome_of = [](std::uint64_t) { return RefineOutcome::DeviceLost; };
  make().start();
  sink_.wait_for([&](const mesh::MeshFrame&) { return script_.opens > 3; });
  pipeline_->stop();
  EXPECT_EQ(pipeline_->status().state, PipelineState::Stopped);
  EXPECT_EQ(script_.refiners_alive, 0);
}

TEST_F(Shading, ADamagedImageIsNotRefined) {
  script_.corrupt_at = 2;
  const PipelineStatus status = run();
  EXPECT_EQ(status.degraded_frames, 1U);
  const auto frames = sink_.frames();
  EXPECT_TRUE(frames[2]->degraded);
  EXPECT_THAT(frames[2]->degraded_reason, HasSubstr("damaged"));
  EXPECT_TRUE(frames[2]->displacements_mm.empty());
}

TEST_F(Shading, OnlyFramesOfTheRangeAreProcessed) {
  ShadingPipeline::Options given = options();
  given.frames = {3, 7};
  const PipelineStatus status = run(given);
  EXPECT_EQ(status.captured, 4U);
  EXPECT_EQ(status.dropped, 0U);
  const auto frames = sink_.frames();
  ASSERT_EQ(frames.size(), 4U);
  EXPECT_EQ(frames.front()->sequence, 3U);
  EXPECT_EQ(frames.back()->sequence, 6U);
}

TEST_F(Shading, ABrokenSourceIsAFailureWithItsReason) {
  script_.fails_at = 5;
  const PipelineStatus status = run();
  EXPECT_EQ(status.state, PipelineState::Failed);
  EXPECT_EQ(status.failure_kind, ErrorKind::UnreadableInput);
  EXPECT_THAT(status.reason, HasSubstr("the cable is out"));
  EXPECT_EQ(sink_.frames().size(), 5U) << "what came before the failure is handed out";
  EXPECT_TRUE(script_.camera_stopped);
}

TEST_F(Shading, ASourceThatEndsEarlySaysWhy) {
  script_.end_note = "scripted: cut off";
  const PipelineStatus status = run();
  EXPECT_EQ(status.state, PipelineState::Ended);
  EXPECT_EQ(status.processed, 10U);
  EXPECT_EQ(status.reason, "scripted: cut off");
}

TEST_F(Shading, ASourceThatCannotStartIsAFailureWithItsReason) {
  script_.throws_at_start = true;
  const PipelineStatus status = run();
  EXPECT_EQ(status.state, PipelineState::Failed);
  EXPECT_EQ(status.failure_kind, ErrorKind::UnreadableInput);
  EXPECT_THAT(status.reason, HasSubstr("cannot start"));
  EXPECT_EQ(status.processed, 0U);
}

TEST_F(Shading, AFaultInAStageEndsThePipelineNotTheProcess) {
  script_.tracker_throws_at = 4;
  const PipelineStatus status = run();
  EXPECT_EQ(status.state, PipelineState::Failed);
  EXPECT_EQ(status.failure_kind, ErrorKind::Internal);
  EXPECT_THAT(status.reason, HasSubstr("scripted tracker fault"));
}

TEST_F(Shading, AnEmptySourceEnds) {
  script_.frame_count = 0;
  const PipelineStatus status = run();
  EXPECT_EQ(status.state, PipelineState::Ended);
  EXPECT_EQ(status.processed, 0U);
}

TEST_F(Shading, IdentityIsResetBetweenFrames) {
  script_.live = true;
  script_.frame_count = ~0ULL;
  make().start();
  pipeline_->reset_identity();
  sink_.wait_for([&](const mesh::MeshFrame&) { return script_.identity_resets == 1; });
  pipeline_->stop();
  EXPECT_EQ(script_.identity_resets, 1);
}

TEST_F(Shading, FramesAreRecycled) {
  script_.frame_count = 200;
  sink_.keep = false;
  run();
  ASSERT_EQ(sink_.addresses.size(), 200U);
  // One at the tracker, one between the stages, one at the GPU, one on its way back.
  EXPECT_LE(std::set(sink_.addresses.begin(), sink_.addresses.end()).size(), 4U);
}

TEST_F(Shading, StopsBeforeItStarted) {
  make().stop();
  EXPECT_TRUE(pipeline_->finished());
  EXPECT_EQ(pipeline_->status().state, PipelineState::Idle);
}

TEST_F(Shading, StopsWhilePreparing) {
  script_.prepare_waits_for_stop = true;
  make().start();
  while (!script_.preparing) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(pipeline_->status().state, PipelineState::Preparing);
  pipeline_->stop();
  EXPECT_EQ(pipeline_->status().state, PipelineState::Stopped);
  EXPECT_TRUE(sink_.frames().empty());
}

TEST_F(Shading, StopsWhileNothingComes) {
  script_.silent = true;
  make().start();
  pipeline_->stop();
  EXPECT_EQ(pipeline_->status().state, PipelineState::Stopped);
  EXPECT_TRUE(script_.camera_stopped);
}

TEST_F(Shading, SaysWhatBecomesOfALiveCamera) {
  script_.live = true;
  script_.camera_changes = {{0, {CameraState::Absent, "scripted: unplugged", {}}},
                            {4, {CameraState::Streaming, "", {}}}};
  const PipelineStatus status = run();
  EXPECT_EQ(status.state, PipelineState::Ended);
  EXPECT_EQ(status.camera.state, CameraState::Streaming);
  std::vector<std::string> said;
  for (const Messages::Message& message : pipeline_->take_messages()) {
    if (message.text.starts_with("camera")) {
      EXPECT_EQ(message.warning, said.empty());
      said.push_back(message.text);
    }
  }
  EXPECT_THAT(said, testing::ElementsAre("camera absent: scripted: unplugged", "camera streaming"));
}

TEST_F(Shading, StopsWhileEveryStageIsBusy) {
  script_.frame_count = ~0ULL;
  script_.refiner_gate.set(false);
  make().start();
  script_.refiner_gate.wait_for_visitor();
  pipeline_->request_stop();
  EXPECT_FALSE(pipeline_->finished()) << "the GPU still holds a frame";
  script_.refiner_gate.set(true);
  pipeline_->stop();
  EXPECT_TRUE(pipeline_->finished());
  EXPECT_EQ(pipeline_->status().state, PipelineState::Stopped);
  EXPECT_EQ(sink_.frames().size(), 1U) << "the frame at the GPU comes out, the others are let go";
}

TEST_F(Shading, StopsTwiceAndFromSeveralThreads) {
  script_.frame_count = ~0ULL;
  make().start();
  sink_.wait_for([](const mesh::MeshFrame& frame) { return frame.sequence > 5; });
  std::thread other([&] { pipeline_->request_stop(); });
  pipeline_->request_stop();
  other.join();
  pipeline_->stop();
  pipeline_->stop();
  EXPECT_EQ(pipeline_->status().state, PipelineState::Stopped);
}

/// Waits until some worker was silent for longer than any wait for another one may be.
Progress::Silence await_silence(const ShadingPipeline& pipeline) {
  for (;;) {
    const auto silence = pipeline.longest_silence();
    if (silence && silence->length > 4 * BoundedQueue<int>::kIdlePeriod) {
      return *silence;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
}

TEST_F(Shading, AHungThreadIsSilentAndThoseThatWaitForItAreNot) {
  const std::array<std::pair<std::string, test::Gate*>, 3> hangs{{{"facet-capture", &script_.camera_gate},
                                                                  {"facet-track", &script_.tracker_gate},
                                                                  {"facet-refine", &script_.refiner_gate}}};
  script_.frame_count = 1000;
  for (const auto& [worker, gate] : hangs) {
    script_.live = worker != "facet-refine";  // a recorded source waits for room meanwhile
    ShadingPipeline& pipeline = make();
    EXPECT_FALSE(pipeline.longest_silence());
    gate->set(false);
    pipeline.start();
    EXPECT_EQ(await_silence(pipeline).worker, worker);
    gate->set(true);
    await_end();
    EXPECT_FALSE(pipeline.longest_silence()) << "no thread is at work any more";
  }
}

TEST_F(Shading, ASilentCameraIsNotAHungThread) {
  script_.live = true;
  script_.silent = true;
  ShadingPipeline& pipeline = make();
  pipeline.start();
  const auto begun = std::chrono::steady_clock::now();
  while (std::chrono::steady_clock::now() - begun < 6 * BoundedQueue<int>::kIdlePeriod) {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  // Well below the time that has passed; how exactly a busy machine wakes threads is not the matter.
  EXPECT_LT(pipeline.longest_silence()->length, 4 * BoundedQueue<int>::kIdlePeriod);
  pipeline.stop();
}

TEST_F(Shading, ALookAheadGetsOn) {
  script_.prepare_waits_for_stop = true;
  ShadingPipeline& pipeline = make();
  pipeline.start();
  std::this_thread::sleep_for(6 * BoundedQueue<int>::kIdlePeriod);
  EXPECT_LT(pipeline.longest_silence()->length, 4 * BoundedQueue<int>::kIdlePeriod);
  pipeline.stop();
}

}  // namespace
}  // namespace facet::pipeline
