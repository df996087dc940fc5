#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <thread>

#include "facet/error.hpp"
#include "pipeline/shading.hpp"
#include "render/renderer.hpp"
#include "render/video_writer.hpp"
#include "scripted_stages.hpp"
#include "support/paths.hpp"

namespace facet::pipeline {

using Frames = std::vector<std::shared_ptr<const mesh::MeshFrame>>;

/// The pipeline with its real stages on sequences put together from real clips of 400x300 px.
class Film : public ::testing::Test {
 protected:
  void SetUp() override {
    config_.source.path = folder_.path() / "faces.mkv";
    config_.model_file = test::default_model();
    config_.tracker.landmark_nets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
    config_.hierarchy.min_edge_px = 10;
    for (const auto& needed :
         {clip("cap12_edit"), clip("cap13_edit2"), config_.model_file, config_.tracker.landmark_nets}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
  }

  static std::filesystem::path clip(const std::string& name) {
    return test::assets() / "video" / (name + ".mp4");
  }

  static std::vector<render::Picture> read(const std::string& name, int count) {
    const auto camera = camera::open_camera({.kind = "file", .path = clip(name)});
    camera->start();
    std::vector<render::Picture> pictures;
    Frame frame;
    while (static_cast<int>(pictures.size()) < count &&
           camera->next(frame, std::chrono::seconds(10)) == CaptureOutcome::Delivered) {
      pictures.push_back(render::to_picture(frame));
    }
    EXPECT_EQ(static_cast<int>(pictures.size()), count);
    return pictures;
  }

  /// A sequence of grey frames into which `draw` puts what is seen.
  void film(int width_px, int frame_count, const std::function<void(render::Picture& onto, int frame)>& draw,
            int height_px = kClipHeight_px, int rate_hz = 25) {
    render::VideoWriter video(config_.source.path, width_px, height_px, rate_hz);
    for (int f = 0; f < frame_count; ++f) {
      render::Picture picture = render::plain_picture(width_px, height_px, {118, 118, 118});
      draw(picture, f);
      video.append(picture);
    }
    video.finish();
  }

  /// The whole way of the film's frames; with coarse meshes where there is no Vulkan device.
  Frames run() {
    ShadingParts stages;
    try {
      stages = open_shading(config_);
    } catch (const Error& error) {
      if (error.kind() != ErrorKind::NoDevice) {
        throw;
      }
      config_.gpu_device = kNoDevice;
      stages = open_shading(config_);
    }
    test::CollectingSink sink;
    ShadingPipeline pipeline(std::move(stages), {config_.hierarchy, config_.frames, {}}, {&sink});
    pipeline.start();
    while (!pipeline.finished()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    status_ = pipeline.status();
    EXPECT_EQ(status_.state, PipelineState::Ended) << status_.reason;
    EXPECT_EQ(status_.dropped, 0U);
    return sink.frames();
  }

  static bool has_mesh(const mesh::MeshFrame& frame) { return frame.control_vertices_mm.cols() > 0; }

  /// Where the head's origin is seen.
  static float seen_at_px(const mesh::MeshFrame& frame) {
    const Eigen::Vector3f head_mm = frame.camera_from_head.translation();
    return frame.camera.fx * head_mm.x() / head_mm.z() + frame.camera.cx;
  }

  static void expect_plausible(const mesh::MeshFrame& frame) {
    SCOPED_TRACE(frame.sequence);
    EXPECT_EQ(has_mesh(frame), frame.state == mesh::TrackingState::Tracking);
    if (!has_mesh(frame)) {
      return;
    }
    EXPECT_TRUE(frame.camera_from_head.matrix().allFinite());
    EXPECT_TRUE(frame.control_vertices_mm.allFinite());
    EXPECT_LT(frame.control_vertices_mm.cwiseAbs().maxCoeff(), 300) << "no vertex of a head is further out";
    EXPECT_GT(frame.camera_from_head.translation().z(), 100);
    EXPECT_LT(frame.camera_from_head.translation().z(), 5000);
    for (const float displacement_mm : frame.displacements_mm) {
      ASSERT_LE(std::abs(displacement_mm), config_bound_mm);
    }
  }

  static constexpr int kClipWidth_px = 400;
  static constexpr int kClipHeight_px = 300;
  static constexpr int kFaceMiddle_px = 205;  ///< of the clip's face, and half its width
  static constexpr int kFaceHalf_px = 60;
  static constexpr float config_bound_mm = 6.001F;  ///< RefinerConfig::displacement_bound_mm
  test::TemporaryFolder folder_;
  ShadingConfig config_;
  PipelineStatus status_;
};

}  // namespace facet::pipeline
