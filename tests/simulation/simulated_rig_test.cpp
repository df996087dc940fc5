#include "simulation/simulated_rig.hpp"

#include <gtest/gtest.h>

#include <thread>

#include "facet/error.hpp"

namespace facet::simulation {
namespace {

using namespace std::chrono_literals;

constexpr LineMask kCameras = 0b0001;
constexpr LineMask kProjectors = 0b0110;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

TEST(SimulatedRig, ACameraSeesWhatTheProjectorsShowWhenItIsFired) {
  SimulatedRig rig(kCameras, kProjectors);
  const auto camera = rig.camera({"left", 640, 480, 30}, true);
  EXPECT_TRUE(camera->info().live);
  Frame frame;
  EXPECT_EQ(camera->next(frame, 1ms), CaptureOutcome::EndOfStream) << "not started";
  camera->start();
  EXPECT_EQ(camera->status().state, CameraState::Opening);
  EXPECT_EQ(camera->next(frame, 1ms), CaptureOutcome::Timeout);
  for (std::uint64_t shot = 0; shot < 5; ++shot) {
    const LineMask pattern = shot % 2 == 0 ? 0b0100 : 0b0010;
    const std::int64_t fired_ns = now_ns();
    rig.on_change(pattern, fired_ns - 100);
    rig.on_change(pattern | kCameras, fired_ns);
    rig.on_change(pattern, fired_ns + 100);
    ASSERT_EQ(camera->next(frame, 1s), CaptureOutcome::Delivered);
    EXPECT_EQ(frame.timestamp_ns, fired_ns);
    EXPECT_GE(now_ns(), fired_ns + 2'000'000);
    EXPECT_EQ(frame.sequence, shot);
    EXPECT_EQ(read_marker(frame, Marker::Count), shot);
    EXPECT_EQ(read_marker(frame, Marker::Lines), pattern);
  }
  EXPECT_EQ(camera->status().state, CameraState::Streaming);
  camera->stop();
  rig.on_change(kCameras, now_ns());
  EXPECT_EQ(camera->next(frame, 1ms), CaptureOutcome::EndOfStream);
}

TEST(SimulatedRig, AllCameraLinesMustBeActive) {
  SimulatedRig rig(0b0011, 0);
  const auto camera = rig.camera({"left", 64, 16, 30}, true);
  camera->start();
  Frame frame;
  rig.on_change(0b0001, now_ns());
  EXPECT_EQ(camera->next(frame, 20ms), CaptureOutcome::Timeout);
  rig.on_change(0b0011, now_ns());
  EXPECT_EQ(camera->next(frame, 1s), CaptureOutcome::Delivered);
  rig.on_change(0b0001, now_ns());
  rig.on_change(0b0011, now_ns());
  EXPECT_EQ(camera->next(frame, 1s), CaptureOutcome::Delivered);
  EXPECT_EQ(read_marker(frame, Marker::Count), 1U);
}

TEST(SimulatedRig, ASlowReaderLosesTheOldestAndTheNumbersSaySo) {
  SimulatedRig rig(kCameras, 0);
  const auto camera = rig.camera({"left", 64, 16, 30}, true);
  camera->start();
  for (int shot = 0; shot < 10; ++shot) {
    rig.on_change(kCameras, now_ns());
    rig.on_change(0, now_ns());
  }
  Frame frame;
  ASSERT_EQ(camera->next(frame, 1s), CaptureOutcome::Delivered);
  EXPECT_EQ(frame.sequence, 6U);
  EXPECT_EQ(camera->status().counters.lost, 6U);
}

TEST(SimulatedRig, ACameraThatNobodyTriggersRunsByItself) {
  SimulatedRig rig(kCameras, 0);
  const auto camera = rig.camera({"free", 64, 16, 200}, false);
  camera->start();
  Frame first;
  Frame second;
  ASSERT_EQ(camera->next(first, 1s), CaptureOutcome::Delivered);
  ASSERT_EQ(camera->next(second, 1s), CaptureOutcome::Delivered);
  EXPECT_EQ(second.timestamp_ns - first.timestamp_ns, 5'000'000);
  EXPECT_EQ(second.sequence, 1U);
}

TEST(SimulatedRig, OtherPicturesHaveNoMarker) {
  Frame frame;
  frame.width_px = 64;
  frame.height_px = 16;
  frame.stride_bytes = 256;
  auto pixels = std::make_shared<std::uint8_t[]>(256 * 16);
  std::fill_n(pixels.get(), 256 * 16, std::uint8_t{128});
  frame.pixels = pixels;
  EXPECT_THROW(read_marker(frame, Marker::Lines), Error);
}

}  // namespace
}  // namespace facet::simulation
