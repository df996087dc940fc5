// The sample driver of docs/adding-a-camera.md keeps the contract of facet::Camera.

#include "sample_camera.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>
#include <string>
#include <thread>
#include <type_traits>
#include <variant>

#include "camera/device_fault.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"

namespace facet::sample {
namespace {

using namespace std::chrono_literals;
using camera::DeviceFault;
using ::testing::HasSubstr;

/// A device that gives what a test puts into it.
class ScriptedDevice final : public SampleDevice {
 public:
  bool there = true;
  bool refuses = false;
  int opened = 0;  ///< now
  std::deque<Picture> pictures;

  void expose(std::uint32_t number) {
    pictures.push_back({number, Clock::now_ns(),
                        std::vector<std::uint8_t>(std::size_t{64} * 48, static_cast<std::uint8_t>(number))});
  }

  bool is_there() override { return there; }
  std::vector<double> rates_hz() override { return {15, 30}; }
  void open(double /*rate_hz*/) override {
    if (!there) {
      throw DeviceFault(DeviceFault::Kind::Absent, "no such device");
    }
    if (refuses) {
      throw DeviceFault(DeviceFault::Kind::Failing, "is in use");
    }
    ++opened;
  }
  void close() override { --opened; }
  std::optional<Picture> take(std::chrono::milliseconds timeout) override {
    if (!there) {
      throw DeviceFault(DeviceFault::Kind::Absent, "was unplugged");
    }
    if (pictures.empty()) {
      std::this_thread::sleep_for(timeout);
      return std::nullopt;
    }
    Picture picture = std::move(pictures.front());
    pictures.pop_front();
    return picture;
  }
};

class SampleCameraTest : public ::testing::Test {
 protected:
  /// Calls next until the camera is in a state.
  static bool becomes(Camera& camera, CameraState state) {
    Frame frame;
    for (int i = 0; i < 2000 && camera.status().state != state; ++i) {
      camera.next(frame, 5ms);
    }
    return camera.status().state == state;
  }

  ScriptedDevice device_;
  camera::LiveConfig config_{.width_px = 64, .height_px = 48};
  Frame frame_;
};

TEST_F(SampleCameraTest, HandsOutTheNewestPictureAndCountsTheRest) {
  const auto camera = open_sample_camera(config_, device_);
  EXPECT_EQ(camera->next(frame_, 0ms), CaptureOutcome::EndOfStream) << "before start";
  camera->start();
  EXPECT_EQ(camera->next(frame_, 1ms), CaptureOutcome::Timeout);
  EXPECT_EQ(camera->status().state, CameraState::Opening);
  device_.expose(7);
  ASSERT_EQ(camera->next(frame_, 1s), CaptureOutcome::Delivered);
  EXPECT_EQ(frame_.sequence, 0U);
  EXPECT_EQ(frame_.media_time_ns, 0);
  const std::uint8_t* last = frame_.row(47) + 252;
  EXPECT_EQ(last[0], 7);
  EXPECT_EQ(last[3], 255);
  EXPECT_EQ(camera->status().state, CameraState::Streaming);
  device_.expose(8);
  device_.expose(11);
  ASSERT_EQ(camera->next(frame_, 1s), CaptureOutcome::Delivered);
  EXPECT_EQ(frame_.sequence, 4U);
  const CameraCounters counters = camera->status().counters;
  EXPECT_EQ(counters.delivered, 2U);
  EXPECT_EQ(counters.skipped, 1U);
  EXPECT_EQ(counters.lost, 2U);
  camera->stop();
  EXPECT_EQ(device_.opened, 0);
  EXPECT_EQ(camera->next(frame_, 0ms), CaptureOutcome::EndOfStream);
}

TEST_F(SampleCameraTest, TheRowOpensAndListsIt) {
  plugged_in() = &device_;
  camera::CameraConfig config{.kind = kSampleCamera.name, .live = config_};
  EXPECT_EQ(kSampleCamera.open(config)->info().width_px, 64);
  ASSERT_EQ(kSampleCamera.list().size(), 1U);
  EXPECT_EQ(kSampleCamera.list()[0].text, "sample camera: 15, 30 Hz");
  std::visit(
      [&](auto place) {
        if constexpr (std::is_same_v<decltype(place(config)), double&>) {
          place(config) = 15;
        }
      },
      kSampleCamera.find("rate_hz")->place);
  EXPECT_EQ(config.live.rate_hz, 15);
  EXPECT_EQ(kSampleCamera.find("device"), nullptr);
  device_.there = false;
  EXPECT_TRUE(kSampleCamera.list().empty());
}

TEST_F(SampleCameraTest, SaysWhatTheDeviceHas) {
  config_.rate_hz = 60;
  try {
    open_sample_camera(config_, device_);
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Usage);
    EXPECT_THAT(error.what(), HasSubstr("rate_hz = 60: the camera has 15, 30"));
  }
}

TEST_F(SampleCameraTest, AnAbsentDeviceIsAState) {
  device_.there = false;
  const auto camera = open_sample_camera(config_, device_);
  EXPECT_EQ(camera->status().state, CameraState::Absent);
  camera->start();
  EXPECT_EQ(camera->next(frame_, 1ms), CaptureOutcome::Timeout);
  device_.there = true;
  device_.expose(0);
  EXPECT_TRUE(becomes(*camera, CameraState::Streaming));
}

TEST_F(SampleCameraTest, SilenceIsNoStallWhileNoFramesAreDue) {
  config_.stall_after = 50ms;
  const auto camera = open_sample_camera(config_, device_);
  camera->start();
  device_.expose(0);
  ASSERT_TRUE(becomes(*camera, CameraState::Streaming));
  camera->expect_frames(false);
  EXPECT_EQ(camera->next(frame_, 150ms), CaptureOutcome::Timeout);
  EXPECT_EQ(camera->status().state, CameraState::Streaming);
  camera->expect_frames(true);
  ASSERT_TRUE(becomes(*camera, CameraState::Stalled));
}

TEST_F(SampleCameraTest, ComesBackFromEveryFault) {
  config_.stall_after = 50ms;
  const auto camera = open_sample_camera(config_, device_);
  camera->start();
  device_.expose(0);
  ASSERT_TRUE(becomes(*camera, CameraState::Streaming));
  ASSERT_TRUE(becomes(*camera, CameraState::Stalled));
  EXPECT_THAT(camera->status().reason, HasSubstr("sample camera: no frame for 0."));
  device_.expose(0);
  ASSERT_TRUE(becomes(*camera, CameraState::Streaming));
  device_.there = false;
  ASSERT_TRUE(becomes(*camera, CameraState::Absent));
  device_.there = true;
  device_.refuses = true;
  ASSERT_TRUE(becomes(*camera, CameraState::Failing));
  EXPECT_THAT(camera->last_error(), HasSubstr("is in use"));
  device_.refuses = false;
  device_.expose(0);
  ASSERT_TRUE(becomes(*camera, CameraState::Streaming));
  camera->restart("out of step");
  EXPECT_THAT(camera->status().reason, HasSubstr("out of step"));
  EXPECT_EQ(camera->status().counters.reopened, 2U);
}

}  // namespace
}  // namespace facet::sample
