// Several calibrated cameras live, and as a take of frame sets: what they make of the virtual actor, and what
// becomes of it when one is not there.

#include "pipeline/live_cameras.hpp"

#include <atomic>
#include <cmath>
#include <utility>

#include "camera/simulated_devices.hpp"
#include "take/recorder.hpp"
#include "views_fixture.hpp"

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// A live camera that is silent while it is held.
class HeldCamera final : public Camera {
 public:
  HeldCamera(std::unique_ptr<Camera> camera, std::atomic<bool>& held)
      : camera_(std::move(camera)), held_(held) {}

  CameraInfo info() const override { return camera_->info(); }
  CameraStatus status() const override {
    return held_ ? CameraStatus{CameraState::Stalled, "no frame for 2 s", {}} : camera_->status();
  }
  void start() override { camera_->start(); }
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    const CaptureOutcome outcome = camera_->next(out, timeout);
    return held_ ? CaptureOutcome::Timeout : outcome;
  }
  void stop() override { camera_->stop(); }
  std::string last_error() const override { return ""; }

 private:
  std::unique_ptr<Camera> camera_;
  std::atomic<bool>& held_;
};

class FollowedLive : public Views {
 protected:
  // A busy machine, too, decodes them as fast as they are played: what it does not, comes too late for its
  // set.
  FollowedLive() : Views(3, 10, 10) {}

  void SetUp() override {
    Views::SetUp();
    config_.tracker.acquisition_frames = 5;
  }

  /// The videos as cameras that run freely.
  DevicesConfig video_cameras(bool loop = true) const {
    DevicesConfig devices;
    for (const RecordedCamera& view : config_.views) {
      DeviceCamera camera;
      camera.name = view.camera.name;
      camera.source = view.source;
      camera.source.loop = loop;
      devices.cameras.push_back(camera);
    }
    return devices;
  }

  /// The videos' pictures as frame sets. gone: slot of the second camera's missing picture.
  std::filesystem::path record_sets(std::uint64_t first_slot, std::uint64_t gone = ~0ULL) const {
    take::TakeRecorderConfig recording;
    recording.file = folder_.path() / (std::to_string(first_slot) + ".take");
    recording.when_full = take::WhenFull::Wait;
    recording.with_images = true;
    take::TakeRecorder recorder(recording);
    recorder.start();
    const auto names = std::make_shared<std::vector<std::string>>();
    std::vector<std::unique_ptr<Camera>> cameras;
    for (const RecordedCamera& view : config_.views) {
      names->push_back(view.camera.name);
      cameras.push_back(camera::open_camera(view.source));
      cameras.back()->start();
    }
    for (int i = 0; i < frames_; ++i) {
      const auto set = std::make_shared<FrameSet>();
      set->slot = first_slot + static_cast<std::uint64_t>(i);
      set->camera_names = names;
      set->frames.resize(cameras.size());
      for (std::size_t c = 0; c < cameras.size(); ++c) {
        EXPECT_EQ(cameras[c]->next(set->frames[c], 10s), CaptureOutcome::Delivered);
      }
      const auto frame = std::make_shared<mesh::MeshFrame>();
      set->trigger_ns = set->frames[0].media_time_ns;
      frame->sequence = set->slot;
      frame->media_time_ns = set->trigger_ns;
      frame->timestamp_ns = set->trigger_ns;
      frame->control_vertices_mm.resize(3, 0);
      if (set->slot == gone) {
        set->frames[1] = {};
        set->missing = 2;
      }
      frame->images = set;
      recorder.record(frame);
    }
    EXPECT_EQ(recorder.stop().state, take::RecorderState::Finished);
    return recording.file;
  }

  LiveCamerasPipeline pipeline_of(LiveCameras views, test::CollectingSink& sink) const {
    return {std::move(views), {config_.hierarchy, {}, {}}, {&sink}};
  }

  static bool tracked(const mesh::MeshFrame& frame) { return frame.state == mesh::TrackingState::Tracking; }
  static bool whole(const mesh::MeshFrame& frame) {
    return tracked(frame) && frame.degraded_reason.find("no picture") == std::string::npos;
  }
  static bool lacks(const mesh::MeshFrame& frame, const std::string& camera) {
    return tracked(frame) &&
           frame.degraded_reason.find("no picture of camera " + camera) != std::string::npos;
  }

  template <typename Passes>
  static Frames those(const Frames& frames, const Passes& passes) {
    Frames out;
    std::copy_if(frames.begin(), frames.end(), std::back_inserter(out),
                 [&](const auto& frame) { return passes(*frame); });
    return out;
  }

  /// Which of the videos' frames the first set shows is not known.
  double live_distance_error(const Frames& frames) const {
    EXPECT_GE(frames.size(), 5U);
    double least = 1;
    for (int first = 0; first < frames_; ++first) {
      least = std::min(least, worst_distance_error(frames, static_cast<std::size_t>(first)));
    }
    return least;
  }

  static constexpr double kLargestError = 0.015;  ///< as that of the recorded videos in Views
};

TEST_F(FollowedLive, AreAsNearToTheTruthAsTheVideos) {
  config_.gpu_device = kNoDevice;
  const double recorded = worst_distance_error(run());
  EXPECT_LT(recorded, kLargestError);
  test::CollectingSink sink;
  auto pipeline = pipeline_of(open_live_cameras(video_cameras(), rig_file(), config_), sink);
  EXPECT_EQ(pipeline.status().state, PipelineState::Idle);
  pipeline.start();
  int meshes = 0;
  sink.wait_for([&](const mesh::MeshFrame& frame) { return whole(frame) && ++meshes > 20; });
  const PipelineStatus status = pipeline.status();
  EXPECT_EQ(status.state, PipelineState::Running);
  ASSERT_TRUE(status.rig.has_value());
  ASSERT_EQ(status.rig->cameras.size(), 3U);
  EXPECT_EQ(status.rig->cameras[2].name, "view-3");
  EXPECT_EQ(status.rig->cameras[2].status.state, CameraState::Streaming);
  EXPECT_GT(status.rig->sets.complete, 20U);
  EXPECT_GE(status.mesh_frames, 20U);
  EXPECT_TRUE(pipeline.longest_silence().has_value());
  pipeline.stop();
  EXPECT_TRUE(pipeline.finished());
  EXPECT_EQ(pipeline.status().state, PipelineState::Stopped);
  const Frames frames = those(sink.frames(), whole);
  EXPECT_LT(live_distance_error(frames), kLargestError);
  EXPECT_FLOAT_EQ(frames.back()->camera.fx, static_cast<float>(rig_.cameras.front().lens.fx_px));
  EXPECT_EQ(frames.back()->images, nullptr);
}

TEST_F(FollowedLive, GoOnWithTheOthersWhereACameraEnds) {
  config_.gpu_device = kNoDevice;
  // The reference camera, too: meshes stay in its frame.
  for (const std::size_t ends : {std::size_t{1}, std::size_t{0}}) {
    SCOPED_TRACE(ends);
    DevicesConfig devices = video_cameras();
    devices.cameras[ends].source.loop = false;
    const std::string& name = devices.cameras[ends].name;
    test::CollectingSink sink;
    auto pipeline = pipeline_of(open_live_cameras(devices, rig_file(), config_), sink);
    pipeline.start();
    int meshes = 0;
    sink.wait_for([&](const mesh::MeshFrame& frame) { return lacks(frame, name) && ++meshes > 10; });
    const PipelineStatus status = pipeline.status();
    pipeline.stop();
    EXPECT_EQ(status.state, PipelineState::Running);
    EXPECT_GT(status.degraded_frames, 10U);
    EXPECT_THAT(status.degraded_reason, HasSubstr("no picture of camera " + name));
    EXPECT_EQ(status.rig->cameras[ends].status.state, CameraState::Ended);
    EXPECT_EQ(status.rig->cameras[2].status.state, CameraState::Streaming);
    EXPECT_GT(status.rig->sets.cameras[ends].missing, 10U);
    EXPECT_LT(live_distance_error(those(sink.frames(), [&](const auto& one) { return lacks(one, name); })),
              2 * kLargestError);
  }
}

TEST_F(FollowedLive, UseACameraAgainThatComesBack) {
  std::atomic<bool> held = false;
  auto views = opened([&] { return open_live_cameras(video_cameras(), rig_file(), config_); });
  const std::string name = views.devices.config.cameras[0].name;
  views.devices.cameras[0] = std::make_unique<HeldCamera>(std::move(views.devices.cameras[0]), held);
  test::CollectingSink sink;
  auto pipeline = pipeline_of(std::move(views), sink);
  pipeline.start();
  sink.wait_for(whole);
  held = true;
  int meshes = 0;
  sink.wait_for([&](const mesh::MeshFrame& frame) { return lacks(frame, name) && ++meshes > 5; });
  EXPECT_EQ(pipeline.status().rig->cameras[0].status.state, CameraState::Stalled);
  held = false;
  meshes = 0;
  sink.wait_for([&](const mesh::MeshFrame& frame) { return whole(frame) && ++meshes > 5; });
  EXPECT_EQ(pipeline.status().rig->cameras[0].status.state, CameraState::Streaming);
  EXPECT_EQ(pipeline.status().subjects, 1U) << "the same face all the time";
  std::string log;
  for (const Messages::Message& message : pipeline.take_messages()) {
    log += message.text + "\n";
  }
  EXPECT_THAT(log, HasSubstr("camera " + name + " stalled: no frame for 2 s"));
  pipeline.stop();
  const Frames frames = those(sink.frames(), tracked);
  for (const auto& frame : frames) {
    EXPECT_EQ(frame->displacements_mm.empty(), config_.gpu_device == kNoDevice) << frame->degraded_reason;
  }
  EXPECT_LT(live_distance_error(frames), 2 * kLargestError);
}

TEST_F(FollowedLive, EndWithTheLastCamera) {
  config_.gpu_device = kNoDevice;
  test::CollectingSink sink;
  auto pipeline = pipeline_of(open_live_cameras(video_cameras(false), rig_file(), config_), sink);
  pipeline.start();
  while (!pipeline.finished()) {
    std::this_thread::sleep_for(5ms);
  }
  EXPECT_EQ(pipeline.status().state, PipelineState::Ended) << pipeline.status().reason;
  ASSERT_FALSE(sink.frames().empty());
  // The cameras' clocks start one after the other: a late one may have a slot of its own at the end.
  EXPECT_NEAR(static_cast<double>(sink.frames().back()->sequence), frames_ - 1, 3)
      << "nothing is left behind";
}

/// A trigger fires the cameras: every slot shows the next of the sequence's frames, the last one stays.
TEST_F(FollowedLive, ATriggersSlotsAreTheFramesNumbers) {
  config_.gpu_device = kNoDevice;
  DevicesConfig devices;
  devices.footage = record_sets(0);
  for (const RecordedCamera& view : config_.views) {
    DeviceCamera camera;
    camera.name = view.camera.name;
    camera.source.kind = camera::kSimulatedCamera.name;
    camera.source.live.width_px = view.camera.lens.width_px;
    camera.source.live.height_px = view.camera.lens.height_px;
    devices.cameras.push_back(camera);
  }
  devices.trigger = TriggerKind::Virtual;
  devices.gpio.thread.real_time = false;
  devices.program.slots_per_second = 4;
  devices.program.exposure_ns = 2'000'000;
  devices.program.tolerance_ns = 50'000'000;
  devices.program.lines.push_back({.name = "cameras"});
  devices.program.patterns = {0};
  config_.tracker.acquisition_frames = 2;
  test::CollectingSink sink;
  auto pipeline = pipeline_of(open_live_cameras(devices, rig_file(), config_), sink);
  EXPECT_EQ(pipeline.status().source.rate_hz, 4);
  pipeline.start();
  const auto last = static_cast<std::uint64_t>(frames_ - 1);
  int meshes = 0;
  sink.wait_for([&](const mesh::MeshFrame& frame) { return whole(frame) && ++meshes > 4; });
  ASSERT_TRUE(pipeline.status().rig->trigger.has_value());
  pipeline.stop();
  Frames shown;
  for (const auto& frame : those(sink.frames(), whole)) {
    const auto one = std::make_shared<mesh::MeshFrame>(*frame);
    one->sequence = std::min(frame->sequence, last);
    shown.push_back(one);
  }
  EXPECT_LT(worst_distance_error(shown), 2 * kLargestError);
}

TEST_F(FollowedLive, WhatDoesNotFitTheRigFileIsTold) {
  config_.gpu_device = kNoDevice;
  DevicesConfig devices = video_cameras();
  const auto open = [&] { open_live_cameras(devices, rig_file(), config_); };
  devices.cameras[1].name = "left";
  expect_refused(open, ErrorKind::Usage,
                 AllOf(HasSubstr(rig_file().string()), HasSubstr("no camera 'left'"),
                       HasSubstr("video, view-2, view-3"), HasSubstr("[[camera]]")));
  devices = video_cameras();
  film("small.mkv", 320, 240, frames_);
  devices.cameras[2].source.path = folder_.path() / "small.mkv";
  expect_refused(open, ErrorKind::Usage,
                 AllOf(HasSubstr(rig_file().string()), HasSubstr("camera 'view-3'"), HasSubstr("320 x 240"),
                       HasSubstr("480 x 360")));
  expect_refused([&] { check(devices, ""); }, ErrorKind::Usage, HasSubstr("rig.file is missing"));
  devices.trigger = TriggerKind::Virtual;
  devices.cameras.resize(1);
  devices.cameras[0].source.kind = camera::kSimulatedCamera.name;
  devices.program.lines = {{.name = "cameras"}, {.name = "stripes", .role = LineRole::Projector}};
  devices.program.patterns = {2, 0};
  devices.program.exposure_ns = 1'000'000;
  expect_refused([&] { check(devices, rig_file()); }, ErrorKind::Usage,
                 AllOf(HasSubstr("trigger.patterns"), HasSubstr("mode = \"booth\"")));
  devices.program.patterns = {2, 2};
  check(devices, rig_file());
  expect_refused([&] { calibration_of(devices, folder_.path() / "none.toml"); }, ErrorKind::UnreadableInput,
                 HasSubstr("none.toml"));
}

TEST_F(FollowedLive, ATakeOfFrameSetsGivesTheVideosMeshes) {
  config_.gpu_device = kNoDevice;
  const Frames of_videos = run();
  ASSERT_EQ(of_videos.size(), static_cast<std::size_t>(frames_));
  constexpr std::uint64_t kFirst = 200;
  constexpr std::uint64_t kGone = kFirst + 7;
  std::vector<std::string> names;
  std::vector<capture::RigCamera> known;
  for (const capture::RigCamera& camera : rig_.cameras) {
    names.push_back(camera.name);
    known.push_back(camera);
  }
  const auto views_of = [&](const std::filesystem::path& take, const FrameRange& slots = {}) {
    return [&, take, slots] { return calibrated(take_sets(take, names, slots), known, rig_file()); };
  };
  const auto take = record_sets(kFirst, kGone);
  const Frames of_take = run(open_shading(config_, views_of(take)));
  ASSERT_EQ(of_take.size(), of_videos.size()) << status_.reason;
  EXPECT_EQ(status_.dropped, 0U);
  for (std::size_t i = 0; i < of_take.size(); ++i) {
    const mesh::MeshFrame& frame = *of_take[i];
    EXPECT_EQ(frame.sequence, kFirst + i);
    EXPECT_EQ(frame.state, of_videos[i]->state);
    EXPECT_EQ(lacks(frame, "view-2"), frame.sequence == kGone) << frame.degraded_reason;
    if (frame.sequence < kGone) {
      EXPECT_LT((frame.camera_from_head.translation() - of_videos[i]->camera_from_head.translation()).norm(),
                1.0F);
    }
  }
  // Without the gap they are the same to the bit.
  const Frames same = run(open_shading(config_, views_of(record_sets(0))));
  ASSERT_EQ(same.size(), of_videos.size());
  for (std::size_t i = 0; i < same.size(); ++i) {
    EXPECT_EQ(same[i]->control_vertices_mm, of_videos[i]->control_vertices_mm) << i;
    EXPECT_EQ(same[i]->camera_from_head.matrix(), of_videos[i]->camera_from_head.matrix()) << i;
  }

  const FrameRange range{kFirst + 4, kFirst + 6};
  EXPECT_EQ(take_sets(take, names, range)->cameras().front().info.frame_count, 2U);
  EXPECT_EQ(take_sets(take, names, range)->cameras().back().info.width_px, 480);
  expect_refused(
      [&] {
        take_sets(take, names, {0, kFirst});
      },
      ErrorKind::UnreadableInput, AllOf(HasSubstr(take.string()), HasSubstr("no picture of camera 'video'")));
  expect_refused(
      [&] {
        take_sets(take, {"video", "top"}, {});
      },
      ErrorKind::Usage, AllOf(HasSubstr("'top'"), HasSubstr("video, view-2, view-3")));
}

}  // namespace
}  // namespace facet::pipeline
