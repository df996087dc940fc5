#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "pipeline/shading.hpp"
#include "render/video_writer.hpp"
#include "scripted_stages.hpp"
#include "simulation/sequence.hpp"
#include "support/paths.hpp"

namespace facet::pipeline {

using Frames = std::vector<std::shared_ptr<const mesh::MeshFrame>>;

/// The virtual actor before several cameras: their videos, their rig file, and the truth, which all tests of
/// a suite share.
class Views : public ::testing::Test {
 protected:
  explicit Views(int cameras = 2, int frames = 5, int rate_hz = 30)
      : cameras_(cameras), frames_(frames), rate_hz_(rate_hz) {}
  static void TearDownTestSuite() { sequence_.reset(); }

  void SetUp() override {
    config_.model_file = test::default_model();
    config_.tracker.landmark_nets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
    config_.hierarchy.min_edge_px = 10;
    for (const auto& needed : {config_.model_file, config_.tracker.landmark_nets}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
    if (sequence_ == nullptr) {
      sequence_ = std::make_unique<test::TemporaryFolder>();
      simulation::ActorSequenceConfig studio;
      studio.seed = 3;
      studio.width_px = 480;
      studio.height_px = 360;
      studio.frame_count = frames_;
      studio.rate_hz = rate_hz_;
      studio.rays_per_pixel = 1;
      studio.camera_count = cameras_;
      simulation::write_sequence(simulation::ActorSequence(face::FaceModel::load(config_.model_file), studio),
                                 sequence_->path(), {}, [](int) {});
    }
    rig_ = capture::read_rig(rig_file());
    for (const capture::RigCamera& camera : rig_.cameras) {
      RecordedCamera view;
      view.camera = camera;
      view.rig_file = rig_file();
      view.source.path = video(camera.name);
      config_.views.push_back(view);
    }
  }

  std::filesystem::path rig_file() const { return sequence_->path() / "rig.toml"; }
  std::filesystem::path video(const std::string& camera) const {
    return sequence_->path() / (camera + ".mkv");
  }

  void film(const std::string& name, int width_px, int height_px, int frames) const {
    render::VideoWriter video(folder_.path() / name, width_px, height_px, 30);
    for (int f = 0; f < frames; ++f) {
      video.append(render::plain_picture(width_px, height_px, {40, 40, 40}));
    }
    video.finish();
  }

  /// open(): with coarse meshes where there is no Vulkan device.
  template <typename Open>
  auto opened(const Open& open) {
    try {
      return open();
    } catch (const Error& error) {
      if (error.kind() != ErrorKind::NoDevice) {
        throw;
      }
      config_.gpu_device = kNoDevice;
      return open();
    }
  }

  Frames run(ShadingParts stages) {
    test::CollectingSink sink;
    ShadingPipeline pipeline(std::move(stages), {config_.hierarchy, {}, {}}, {&sink});
    pipeline.start();
    while (!pipeline.finished()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    status_ = pipeline.status();
    return sink.frames();
  }
  Frames run() {
    return run(opened([this] { return open_shading(config_); }));
  }

  /// Of the head's place, over all frames, as a part of its distance. first: the sequence's frame that the
  /// frame of number 0 shows; it goes round.
  double worst_distance_error(const Frames& frames, std::size_t first = 0) const {
    std::ifstream stream(sequence_->path() / "camera.json");
    const auto truth = nlohmann::json::parse(stream).at("frames");
    double worst = 0;
    for (const auto& frame : frames) {
      EXPECT_EQ(frame->state, mesh::TrackingState::Tracking) << frame->sequence;
      const auto pose = truth.at((frame->sequence + first) % truth.size()).at("camera_from_head");
      const Eigen::Vector3f place(pose.at(0).at(3), pose.at(1).at(3), pose.at(2).at(3));
      worst = std::max(
          worst, static_cast<double>((frame->camera_from_head.translation() - place).norm() / place.norm()));
    }
    return worst;
  }

  template <typename Open>
  static void expect_refused(const Open& open, ErrorKind kind,
                             const ::testing::Matcher<std::string>& message) {
    try {
      open();
      FAIL() << "was opened";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), kind);
      EXPECT_THAT(std::string(error.what()), message);
    }
  }

  int cameras_;
  int frames_;
  int rate_hz_;
  static inline std::unique_ptr<test::TemporaryFolder> sequence_;
  test::TemporaryFolder folder_;  ///< of the test's own files
  ShadingConfig config_;
  capture::Rig rig_;
  PipelineStatus status_;
};

}  // namespace facet::pipeline
