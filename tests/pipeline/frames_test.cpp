// The pass-through pipeline: devices in, frame sets out, and what becomes of it when devices misbehave.

#include "pipeline/frames.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <fstream>
#include <thread>

#include "camera/simulated_devices.hpp"
#include "facet/error.hpp"
#include "pipeline/sets_on_stream.hpp"
#include "scripted_stages.hpp"
#include "support/paths.hpp"
#include "support/videos.hpp"
#include "trigger/edge_log.hpp"

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;
using simulated::Marker;
using simulated::read_marker;
using testing::AllOf;
using testing::HasSubstr;

/// A program whose projector lines count the slots in binary, modulo 2^bits.
TriggerProgram counting_program(int bits, double slots_per_second) {
  TriggerProgram program;
  TriggerLine cameras;
  cameras.name = "cameras";
  program.lines.push_back(cameras);
  for (int bit = 0; bit < bits; ++bit) {
    TriggerLine line;
    line.name = "bit." + std::to_string(bit);
    line.role = LineRole::Projector;
    program.lines.push_back(line);
  }
  for (LineMask slot = 0; slot < LineMask{1} << bits; ++slot) {
    program.patterns.push_back(slot << 1);
  }
  program.slots_per_second = slots_per_second;
  program.exposure_ns = 2'000'000;
  program.tolerance_ns = 2'000'000;
  return program;
}

DevicesConfig simulated_rig(std::size_t cameras, double slots_per_second) {
  DevicesConfig config;
  for (std::size_t i = 0; i < cameras; ++i) {
    DeviceCamera camera;
    camera.name = "cam" + std::to_string(i);
    camera.source.kind = camera::kSimulatedCamera.name;
    camera.source.live.width_px = 128;
    camera.source.live.height_px = 64;
    camera.source.live.rate_hz = slots_per_second;
    config.cameras.push_back(camera);
  }
  config.trigger = TriggerKind::Virtual;
  config.program = counting_program(6, slots_per_second);
  config.gpio.thread.real_time = false;
  return config;
}

template <typename Condition>
testing::AssertionResult eventually(Condition condition) {
  for (const auto end = std::chrono::steady_clock::now() + 60s; std::chrono::steady_clock::now() < end;) {
    if (condition()) {
      return testing::AssertionSuccess();
    }
    std::this_thread::sleep_for(5ms);
  }
  return testing::AssertionFailure() << "not within a minute";
}

std::string log_of(Pipeline& pipeline) {
  std::string text;
  for (const Messages::Message& message : pipeline.take_messages()) {
    text += (message.warning ? "warning: " : "info: ") + message.text + "\n";
  }
  return text;
}

/// Every picture shows the slot that its set is of.
void expect_no_shift(const std::vector<std::shared_ptr<const FrameSet>>& sets) {
  ASSERT_FALSE(sets.empty());
  std::uint64_t last = 0;
  for (const auto& one : sets) {
    const FrameSet& set = *one;
    EXPECT_EQ(set.media_time_ns, set.trigger_ns - sets.front()->trigger_ns);
    EXPECT_TRUE(one == sets.front() || set.slot > last);
    last = set.slot;
    for (std::size_t i = 0; i < set.frames.size(); ++i) {
      ASSERT_EQ(set.frames[i].empty(), (set.missing >> i & 1) != 0);
      if (!set.frames[i].empty()) {
        EXPECT_EQ(read_marker(set.frames[i], Marker::Lines) >> 1, set.slot % 64) << "slot " << set.slot;
      }
    }
  }
}

/// A live camera that sees nothing until it is told to, and then as the simulated one.
class LateCamera final : public Camera {
 public:
  LateCamera(std::unique_ptr<Camera> camera, std::atomic<bool>& present)
      : camera_(std::move(camera)), present_(present) {}

  CameraInfo info() const override { return camera_->info(); }
  CameraStatus status() const override {
    return present_ ? camera_->status() : CameraStatus{CameraState::Absent, "unplugged", {}};
  }
  void start() override { camera_->start(); }
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    const CaptureOutcome outcome = camera_->next(out, timeout);
    return present_ ? outcome : CaptureOutcome::Timeout;
  }
  void stop() override { camera_->stop(); }
  std::string last_error() const override { return ""; }

 private:
  std::unique_ptr<Camera> camera_;
  std::atomic<bool>& present_;
};

/// A live camera whose time stamps are wrong by half a slot until it is restarted.
class CrookedCamera final : public Camera {
 public:
  CrookedCamera(std::unique_ptr<Camera> camera, std::atomic<int>& restarts)
      : camera_(std::move(camera)), restarts_(restarts) {}

  CameraInfo info() const override { return camera_->info(); }
  CameraStatus status() const override { return camera_->status(); }
  void start() override { camera_->start(); }
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    const CaptureOutcome outcome = camera_->next(out, timeout);
    out.timestamp_ns -= restarts_ == 0 ? 5'000'000 : 0;
    return outcome;
  }
  void restart(const std::string& /*why*/) override { ++restarts_; }
  void stop() override { camera_->stop(); }
  std::string last_error() const override { return ""; }

 private:
  std::unique_ptr<Camera> camera_;
  std::atomic<int>& restarts_;
};

TEST(FramesPipeline, EverySetShowsThePatternOfItsSlot) {
  test::CollectingSets sink;
  FramesPipeline pipeline(open_devices(simulated_rig(3, 100)), {&sink});
  EXPECT_EQ(pipeline.status().state, PipelineState::Idle);
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.complete >= 100; }));
  const PipelineStatus status = pipeline.status();
  EXPECT_EQ(status.state, PipelineState::Running);
  ASSERT_TRUE(status.rig.has_value());
  ASSERT_TRUE(status.rig->trigger.has_value());
  EXPECT_EQ(status.rig->trigger->state, TriggerState::Running);
  EXPECT_EQ(status.rig->cameras.at(2).name, "cam2");
  EXPECT_EQ(status.rig->cameras.at(2).status.state, CameraState::Streaming);
  EXPECT_TRUE(status.rig->sets.cameras.at(2).in_step);
  EXPECT_FALSE(pipeline.finished());
  pipeline.stop();
  EXPECT_TRUE(pipeline.finished());
  EXPECT_EQ(pipeline.status().state, PipelineState::Stopped);
  EXPECT_THROW(pipeline.reset_identity(), Error);
  const auto sets = sink.sets();
  EXPECT_GE(sets.size(), 100U);
  expect_no_shift(sets);
  ASSERT_NE(sets.back()->camera_names, nullptr);
  EXPECT_EQ(sets.back()->camera_names->at(1), "cam1");
}

TEST(SetsOnStream, ASetIsAFrameWithoutAMesh) {
  FrameSet set;
  set.slot = 7;
  set.trigger_ns = 5'000'000;
  set.media_time_ns = 2'000'000;
  set.frames.resize(3);
  set.camera_names =
      std::make_shared<const std::vector<std::string>>(std::vector<std::string>{"left", "top", "right"});
  const auto whole = std::make_shared<const FrameSet>(set);
  set.missing = 5;
  const auto lacking = std::make_shared<const FrameSet>(set);
  test::CollectingSink first;
  test::CollectingSink second;
  SetsOnStream on_stream({&first, &second});
  on_stream.deliver(whole);
  on_stream.deliver(lacking);
  ASSERT_EQ(first.frames().size(), 2U);
  EXPECT_EQ(first.frames(), second.frames()) << "one frame for all";
  const mesh::MeshFrame& frame = *first.frames().front();
  EXPECT_EQ(frame.sequence, 7U);
  EXPECT_EQ(frame.timestamp_ns, 5'000'000);
  EXPECT_EQ(frame.media_time_ns, 2'000'000);
  EXPECT_EQ(frame.images, whole);
  EXPECT_FALSE(mesh::has_mesh(frame));
  EXPECT_GT(frame.stage_ms.latency_ms, 0);
  EXPECT_FALSE(frame.degraded);
  EXPECT_EQ(frame.degraded_reason, "");
  EXPECT_TRUE(first.frames().back()->degraded);
  EXPECT_EQ(first.frames().back()->degraded_reason, "no picture of camera left right");
}

TEST(FramesPipeline, ACameraThatComesLateFillsItsPlace) {
  std::atomic<bool> present = false;
  Devices rig = open_devices(simulated_rig(2, 100));
  rig.cameras[1] = std::make_unique<LateCamera>(std::move(rig.cameras[1]), present);
  test::CollectingSets sink;
  FramesPipeline pipeline(std::move(rig), {&sink});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.cameras[0].in_sets >= 20; }));
  EXPECT_EQ(pipeline.status().rig->sets.complete, 0U);
  EXPECT_THAT(pipeline.status().degraded_reason, HasSubstr("no picture of camera cam1"));
  EXPECT_THAT(log_of(pipeline), HasSubstr("warning: camera cam1 absent: unplugged"));
  present = true;
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.complete >= 20; }));
  EXPECT_THAT(log_of(pipeline), HasSubstr("info: camera cam1 streaming"));
  present = false;
  const std::uint64_t complete = pipeline.status().rig->sets.complete;
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.incomplete >= 60; }));
  EXPECT_LE(pipeline.status().rig->sets.complete, complete + 5);
  pipeline.stop();
  expect_no_shift(sink.sets());
}

TEST(FramesPipeline, ACameraOutOfStepIsLeftOutAndStartedAnew) {
  std::atomic<int> restarts = 0;
  Devices rig = open_devices(simulated_rig(2, 100));
  rig.cameras[1] = std::make_unique<CrookedCamera>(std::move(rig.cameras[1]), restarts);
  test::CollectingSets sink;
  FramesPipeline pipeline(std::move(rig), {&sink});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return restarts > 0; }));
  EXPECT_EQ(pipeline.status().rig->sets.cameras[1].in_sets, 0U);
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.complete >= 20; }));
  ASSERT_TRUE(eventually([text = std::string(), &pipeline]() mutable {
    text += log_of(pipeline);
    return text.find("out of step with the trigger for 5 s") != std::string::npos &&
           text.find("camera cam1 is in step again") != std::string::npos;
  }));
  pipeline.stop();
  expect_no_shift(sink.sets());
}

/// A live camera that stalls where frames are due and stay out.
class WatchfulCamera final : public Camera {
 public:
  WatchfulCamera(std::unique_ptr<Camera> camera, std::atomic<int>& stalls)
      : camera_(std::move(camera)), stalls_(stalls) {}

  CameraInfo info() const override { return camera_->info(); }
  CameraStatus status() const override { return camera_->status(); }
  void start() override { camera_->start(); }
  void expect_frames(bool due) override {
    life_ = due && !due_ ? std::chrono::steady_clock::now() : life_;
    due_ = due;
  }
  CaptureOutcome next(Frame& out, std::chrono::milliseconds timeout) override {
    const CaptureOutcome outcome = camera_->next(out, timeout);
    const auto now = std::chrono::steady_clock::now();
    life_ = outcome == CaptureOutcome::Delivered ? now : life_;
    if (due_ && now - life_ > 1s) {
      ++stalls_;
      life_ = now;
    }
    return outcome;
  }
  void stop() override { camera_->stop(); }
  std::string last_error() const override { return ""; }

 private:
  std::unique_ptr<Camera> camera_;
  std::atomic<int>& stalls_;
  bool due_ = true;
  std::chrono::steady_clock::time_point life_ = std::chrono::steady_clock::now();
};

/// Hands out the trigger of a rig; refuses and breaks it as told.
struct TroubledTrigger {
  OpenTrigger real;
  std::atomic<int> refusals{0};
  std::atomic<int> opened{0};
  std::unique_ptr<Trigger> open() {
    if (refusals > 0) {
      --refusals;
      throw Error(ErrorKind::Unavailable, "chip 'gpiochip9': line 17 is held by 'gpioset'");
    }
    ++opened;
    return real();
  }
};

TEST(FramesPipeline, ATriggerThatCannotBeOpenedIsAStateUntilItCan) {
  Devices rig = open_devices(simulated_rig(1, 100));
  TroubledTrigger trouble{rig.open_trigger};
  trouble.refusals = 1;
  rig.open_trigger = [&] { return trouble.open(); };
  test::CollectingSets sink;
  FramesPipeline pipeline(std::move(rig), {&sink});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return !pipeline.status().rig->trigger->reason.empty(); }));
  EXPECT_EQ(pipeline.status().rig->trigger->state, TriggerState::Failing);
  EXPECT_NE(pipeline.status().state, PipelineState::Failed);
  EXPECT_THAT(pipeline.status().rig->trigger->reason, HasSubstr("held by 'gpioset'"));
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.complete >= 20; }));
  EXPECT_THAT(log_of(pipeline),
              AllOf(HasSubstr("warning: trigger failing: chip"), HasSubstr("trigger running")));
  pipeline.stop();
  expect_no_shift(sink.sets());
}

TEST(FramesPipeline, CamerasWaitForATriggerThatStandsStill) {
  std::atomic<int> stalls = 0;
  Devices rig = open_devices(simulated_rig(1, 100));
  rig.cameras[0] = std::make_unique<WatchfulCamera>(std::move(rig.cameras[0]), stalls);
  TroubledTrigger trouble{rig.open_trigger};
  trouble.refusals = 2;  // for three seconds
  rig.open_trigger = [&] { return trouble.open(); };
  test::CollectingSets sink;
  FramesPipeline pipeline(std::move(rig), {&sink});
  pipeline.start();
  const auto camera = [&] { return pipeline.status().rig->cameras.at(0).status; };
  ASSERT_TRUE(eventually([&] { return camera().state == CameraState::Waiting; }));
  EXPECT_EQ(camera().reason, "the trigger does not fire");
  ASSERT_TRUE(eventually([&] { return camera().state == CameraState::Streaming; }));
  EXPECT_EQ(camera().reason, "");
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.complete >= 20; }));
  EXPECT_EQ(stalls, 0);
  EXPECT_THAT(log_of(pipeline), AllOf(HasSubstr("warning: camera cam0 waiting: the trigger does not fire"),
                                      HasSubstr("info: camera cam0 streaming")));
  pipeline.stop();
  expect_no_shift(sink.sets());
}

TEST(FramesPipeline, ASilentCameraOfATriggerThatFiresIsStalled) {
  std::atomic<int> stalls = 0;
  const DevicesConfig config = simulated_rig(2, 100);
  Devices rig = open_devices(config);
  // The second camera hangs on no line of this rig.
  simulated::SimulatedDevices elsewhere(1, 0);
  rig.cameras[1] = std::make_unique<WatchfulCamera>(elsewhere.camera({"cam1", 128, 64, 100}, true), stalls);
  FramesPipeline pipeline(std::move(rig), {});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return stalls >= 2; }));
  pipeline.stop();
}

TEST(FramesPipeline, AFaultThatIsOursEndsItWithAReason) {
  Devices rig = open_devices(simulated_rig(1, 100));
  rig.open_trigger = []() -> std::unique_ptr<Trigger> {
    throw Error(ErrorKind::Usage, "wiring does not fit");
  };
  FramesPipeline pipeline(std::move(rig), {});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return pipeline.finished(); }));
  EXPECT_EQ(pipeline.status().state, PipelineState::Failed);
  EXPECT_EQ(pipeline.status().failure_kind, ErrorKind::Usage);
  EXPECT_EQ(pipeline.status().reason, "wiring does not fit");
}

TEST(FramesPipeline, FreeRunningCamerasAreMatchedByTime) {
  DevicesConfig config = simulated_rig(2, 100);
  config.trigger = TriggerKind::None;
  test::CollectingSets sink;
  FramesPipeline pipeline(open_devices(config), {&sink});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.complete >= 50; }));
  EXPECT_FALSE(pipeline.status().rig->trigger.has_value());
  pipeline.stop();
  for (const auto& one : sink.sets()) {
    const FrameSet& set = *one;
    if (set.complete()) {
      EXPECT_LE(std::abs(set.frames[0].timestamp_ns - set.frames[1].timestamp_ns), 5'000'000);
    }
  }
  config.cameras[1].source.live.rate_hz = 50;
  EXPECT_THROW(FramesPipeline(open_devices(config), {}), Error);
}

TEST(FramesPipeline, FilesTakeTheirTimeAndEnd) {
  const test::TemporaryFolder folder;
  DevicesConfig config;
  for (const char* name : {"a", "b"}) {
    DeviceCamera camera;
    camera.name = name;
    camera.source.kind = "file";
    camera.source.path = folder.path() / (std::string(name) + ".mkv");
    test::write_grey_video(camera.source.path, 10);
    config.cameras.push_back(camera);
  }
  test::CollectingSets sink;
  FramesPipeline pipeline(open_devices(config), {&sink});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return pipeline.finished(); }));
  EXPECT_EQ(pipeline.status().state, PipelineState::Ended);
  EXPECT_GE(sink.sets().size(), 8U);
}

TEST(FramesPipeline, TheEdgeLogHoldsWhatTheLinesDid) {
  const test::TemporaryFolder folder;
  DevicesConfig config = simulated_rig(1, 100);
  config.edge_log = folder.path() / "edges.log";
  FramesPipeline pipeline(open_devices(config), {});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.slots >= 10; }));
  pipeline.stop();
  std::ifstream file(config.edge_log);
  const std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  const trigger::EdgeLog log = trigger::parse_edge_log(text, "edges.log");
  EXPECT_EQ(log.lines.size(), config.program.lines.size());
  EXPECT_GE(std::count_if(log.events.begin(), log.events.end(),
                          [](const TriggerEvent& event) { return event.kind == TriggerEvent::Kind::Fired; }),
            10);
}

TEST(FramesPipeline, AnEdgeLogThatCannotBeWrittenIsToldOnce) {
  DevicesConfig config = simulated_rig(1, 100);
  config.edge_log = "/no/such/folder/edges.log";
  FramesPipeline pipeline(open_devices(config), {});
  pipeline.start();
  ASSERT_TRUE(eventually([&] { return pipeline.status().rig->sets.complete >= 10; }));
  pipeline.stop();
  const std::string log = log_of(pipeline);
  const std::size_t first = log.find("edge log '/no/such/folder/edges.log' can't be written");
  ASSERT_NE(first, std::string::npos) << log;
  EXPECT_EQ(log.find("can't be written", first + 60), std::string::npos);
}

std::string refusal(const DevicesConfig& config) {
  try {
    check(config);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    return error.what();
  }
  return "";
}

TEST(DevicesConfig, SaysWhatCannotBe) {
  EXPECT_THAT(refusal({}), HasSubstr("there is no camera"));
  DevicesConfig config = simulated_rig(2, 100);
  EXPECT_EQ(refusal(config), "");
  config.cameras[1].name = "cam0";
  EXPECT_THAT(refusal(config), HasSubstr("two cameras are named 'cam0'"));
  config.cameras[1].name = "a/b";
  EXPECT_THAT(refusal(config), HasSubstr("'a/b' is no name of a camera"));
  config = simulated_rig(1, 100);
  config.trigger = TriggerKind::Gpio;
  EXPECT_THAT(refusal(config), HasSubstr("camera 'cam0' is simulated"));
  config.cameras[0].source.kind = "file";
  EXPECT_THAT(refusal(config), HasSubstr("camera 'cam0' is a file"));
  config = simulated_rig(1, 100);
  config.deadline_ms = 1000;
  EXPECT_THAT(refusal(config), HasSubstr("deadline"));
  config = simulated_rig(1, 100);
  config.program.exposure_ns = 20'000'000;
  EXPECT_THAT(refusal(config), HasSubstr("trigger program"));
}

}  // namespace
}  // namespace facet::pipeline
