// Several calibrated cameras: their videos in step, and what the whole way makes of them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "views_fixture.hpp"

namespace facet::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

TEST_F(Views, KnowWhereTheHeadIsAndGoOnWhenOneIsCovered) {
  const auto both = run();
  ASSERT_EQ(both.size(), static_cast<std::size_t>(frames_)) << status_.reason;
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
    film("covered.mkv", 480, 360, frames_);
    const auto source = config_.views[covered].source;
    config_.views[covered].source.path = folder_.path() / "covered.mkv";
    const auto one = run();
    ASSERT_EQ(one.size(), static_cast<std::size_t>(frames_)) << status_.reason;
    EXPECT_LT(worst_distance_error(one), 0.12);
    for (const auto& frame : one) {
      EXPECT_EQ(frame->displacements_mm.empty(), config_.gpu_device == kNoDevice) << frame->degraded_reason;
    }
    config_.views[covered].source = source;
  }
}

TEST_F(Views, WhatDoesNotGoTogetherIsTold) {
  const auto fine = config_.views;
  film("small.mkv", 320, 240, frames_);
  config_.views[1].source.path = folder_.path() / "small.mkv";
  const auto open = [this] { open_shading(config_); };
  expect_refused(open, ErrorKind::Usage,
                 AllOf(HasSubstr("view-2"), HasSubstr("320 x 240"), HasSubstr("480 x 360"),
                       HasSubstr(rig_file().string())));
  film("short.mkv", 480, 360, frames_ - 2);
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
  expect_refused(open, ErrorKind::UnreadableInput, HasSubstr("none.mkv"));
}

TEST(Calibrated, TheLensIsTakenOutOfThePictures) {
  const test::TemporaryFolder folder;
  render::VideoWriter video(folder.path() / "a.mkv", 64, 48, 30);
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
  const auto pictures =
      calibrated(one_camera(camera::open_camera({.kind = "file", .path = folder.path() / "a.mkv"})),
                 {{"a", lens}}, "rig.toml");
  const PictureCamera camera = pictures->cameras().at(0);
  EXPECT_FLOAT_EQ(camera.info.intrinsics.value().fx, 60);
  EXPECT_TRUE(camera.camera_from_reference.value().isApprox(Eigen::Isometry3d::Identity()));
  pictures->start();
  FrameSet set;
  ASSERT_EQ(pictures->next(set, std::chrono::seconds(10)), CaptureOutcome::Delivered);
  const Frame& frame = set.frames.at(0);
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
