// Several calibrated cameras: their videos in step, and what the whole way makes of them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <thread>

#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "pipeline/calibrated_camera.hpp"
#include "pipeline/monocular.hpp"
#include "scripted_stages.hpp"
#include "simulation/lossless_video.hpp"
#include "simulation/sequence.hpp"
#include "support/paths.hpp"

namespace facet::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr int kFrames = 5;

/// The virtual actor before two cameras.
class Views : public ::testing::Test {
 protected:
  void SetUp() override {
    config_.model_file = test::default_model();
    config_.tracker.landmark_assets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
    config_.hierarchy.min_edge_px = 10;
    for (const auto& needed : {config_.model_file, config_.tracker.landmark_assets}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
    simulation::StudioConfig studio;
    studio.seed = 3;
    studio.width_px = 480;
    studio.height_px = 360;
    studio.frame_count = kFrames;
    studio.rays_per_pixel = 1;
    studio.camera_count = 2;
    simulation::write_sequence(simulation::Studio(face::FaceModel::load(config_.model_file), studio),
                               folder_.path(), [](int) {});
    rig_ = capture::read_rig(folder_.path() / "rig.toml");
    for (const capture::RigCamera& camera : rig_.cameras) {
      ViewConfig view;
      view.camera = camera;
      view.source.path = folder_.path() / (camera.name + ".mkv");
      config_.views.push_back(view);
    }
  }

  void film(const std::string& name, int width_px, int height_px, int frames) const {
    simulation::LosslessVideo video(folder_.path() / name, width_px, height_px, 30);
    for (int f = 0; f < frames; ++f) {
      video.append(render::plain_picture(width_px, height_px, {40, 40, 40}));
    }
    video.finish();
  }

  std::vector<std::shared_ptr<const mesh::MeshFrame>> run() {
    Stages stages;
    try {
      stages = open_stages(config_);
    } catch (const Error& error) {
      if (error.kind() != ErrorKind::NoDevice) {
        throw;
      }
      config_.gpu_device = kNoDevice;
      stages = open_stages(config_);
    }
    test::CollectingSink sink;
    MonocularPipeline pipeline(std::move(stages), {config_.hierarchy, {}, {}}, {&sink});
    pipeline.start();
    while (!pipeline.finished()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    status_ = pipeline.status();
    return sink.frames();
  }

  /// Of the head's place, over all frames, as a part of its distance.
  double worst_distance_error(const std::vector<std::shared_ptr<const mesh::MeshFrame>>& frames) const {
    std::ifstream stream(folder_.path() / "camera.json");
    const auto truth = nlohmann::json::parse(stream).at("frames");
    double worst = 0;
    for (const auto& frame : frames) {
      EXPECT_EQ(frame->state, mesh::TrackingState::Tracking) << frame->sequence;
      const auto pose = truth.at(frame->sequence).at("camera_from_head");
      const Eigen::Vector3f place(pose.at(0).at(3), pose.at(1).at(3), pose.at(2).at(3));
      worst = std::max(
          worst, static_cast<double>((frame->camera_from_head.translation() - place).norm() / place.norm()));
    }
    return worst;
  }

  void expect_refused(ErrorKind kind, const ::testing::Matcher<std::string>& message) const {
    try {
      open_stages(config_);
      FAIL() << "was opened";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), kind);
      EXPECT_THAT(std::string(error.what()), message);
    }
  }

  test::TemporaryFolder folder_;
  MonocularConfig config_;
  capture::Rig rig_;
  PipelineStatus status_;
};

TEST_F(Views, KnowWhereTheHeadIsAndGoOnWhenOneIsCovered) {
  const auto both = run();
  ASSERT_EQ(both.size(), static_cast<std::size_t>(kFrames)) << status_.reason;
  EXPECT_EQ(status_.state, PipelineState::Ended);
  const double with_both = worst_distance_error(both);
  EXPECT_LT(with_both, 0.015);
  EXPECT_FLOAT_EQ(both.front()->camera.fx, static_cast<float>(rig_.cameras.front().lens.fx_px));
  for (const auto& frame : both) {
    EXPECT_EQ(frame->displacements_mm.empty(), config_.gpu_device == kNoDevice) << frame->degraded_reason;
  }

  // Neither view is needed: with something before one camera the other goes on, in the same frame.
  for (std::size_t covered : {std::size_t{1}, std::size_t{0}}) {
    SCOPED_TRACE(covered);
    film("covered.mkv", 480, 360, kFrames);
    const auto source = config_.views[covered].source;
    config_.views[covered].source.path = folder_.path() / "covered.mkv";
    const auto one = run();
    ASSERT_EQ(one.size(), static_cast<std::size_t>(kFrames)) << status_.reason;
    EXPECT_LT(worst_distance_error(one), 0.12);
    for (const auto& frame : one) {
      EXPECT_EQ(frame->displacements_mm.empty(), config_.gpu_device == kNoDevice) << frame->degraded_reason;
    }
    config_.views[covered].source = source;
  }
}

TEST_F(Views, WhatDoesNotGoTogetherIsTold) {
  const auto fine = config_.views;
  film("small.mkv", 320, 240, kFrames);
  config_.views[1].source.path = folder_.path() / "small.mkv";
  expect_refused(ErrorKind::Usage,
                 AllOf(HasSubstr("view-2"), HasSubstr("320 x 240"), HasSubstr("480 x 360")));
  film("short.mkv", 480, 360, kFrames - 2);
  config_.views[1].source.path = folder_.path() / "short.mkv";
  config_.gpu_device = kNoDevice;
  // Where the container says how many frames it has it is told at once, else when they run out.
  try {
    run();
    EXPECT_EQ(status_.state, PipelineState::Failed);
    EXPECT_THAT(status_.reason, AllOf(HasSubstr("short.mkv"), HasSubstr("no frame 3")));
  } catch (const Error& error) {
    EXPECT_THAT(std::string(error.what()), AllOf(HasSubstr("view-2"), HasSubstr("frames")));
  }
  config_.views = fine;
  config_.views[1].source.path = folder_.path() / "none.mkv";
  expect_refused(ErrorKind::UnreadableInput, HasSubstr("none.mkv"));
}

TEST(Calibrated, TheLensIsTakenOutOfThePictures) {
  const test::TemporaryFolder folder;
  simulation::LosslessVideo video(folder.path() / "a.mkv", 64, 48, 30);
  render::Picture picture = render::plain_picture(64, 48, {20, 20, 20});
  for (int y = 20; y < 28; ++y) {
    for (int x = 52; x < 60; ++x) {
      picture.rgb[static_cast<std::size_t>(3 * (y * 64 + x))] = 200;
    }
  }
  video.append(picture);
  video.finish();
  capture::Lens lens;
  lens.width_px = 64;
  lens.height_px = 48;
  lens.fx_px = lens.fy_px = 60;
  lens.cx_px = 31.5;
  lens.cy_px = 23.5;
  lens.distortion.k1 = -0.3;
  const auto camera =
      calibrated(camera::open_camera({.kind = "file", .path = folder.path() / "a.mkv"}), "a", lens);
  EXPECT_FLOAT_EQ(camera->info().intrinsics.value().fx, 60);
  camera->start();
  Frame frame;
  ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered);
  // A barrel lens draws the mark nearer to the middle than it is.
  const auto direction = lens.direction({55.5, 23.5});
  ASSERT_TRUE(direction.has_value());
  const auto straight_px = static_cast<int>(std::lround(60 * direction->x() + 31.5));
  ASSERT_GT(straight_px, 56);
  EXPECT_GT(frame.row(23)[4 * straight_px], 180);
  EXPECT_LT(frame.row(23)[4 * 51], 60);
}

}  // namespace
}  // namespace facet::pipeline
