#include "camera/simulated_devices.hpp"

#include <gtest/gtest.h>

#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "facet/error.hpp"

namespace facet::simulated {
namespace {

using namespace std::chrono_literals;

constexpr LineMask kCameras = 0b0001;
constexpr LineMask kProjectors = 0b0110;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

TEST(SimulatedDevices, ACameraSeesWhatTheProjectorsShowWhenItIsFired) {
  SimulatedDevices rig(kCameras, kProjectors);
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

TEST(SimulatedDevices, AllCameraLinesMustBeActive) {
  SimulatedDevices rig(0b0011, 0);
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

TEST(SimulatedDevices, ASlowReaderLosesTheOldestAndTheNumbersSaySo) {
  SimulatedDevices rig(kCameras, 0);
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

TEST(SimulatedDevices, ACameraThatNobodyTriggersRunsByItself) {
  SimulatedDevices rig(kCameras, 0);
  const auto camera = rig.camera({"free", 64, 16, 200}, false);
  camera->start();
  Frame first;
  Frame second;
  ASSERT_EQ(camera->next(first, 1s), CaptureOutcome::Delivered);
  ASSERT_EQ(camera->next(second, 1s), CaptureOutcome::Delivered);
  EXPECT_EQ(second.timestamp_ns - first.timestamp_ns, 5'000'000);
  EXPECT_EQ(second.sequence, 1U);
}

TEST(SimulatedDevices, OtherPicturesHaveNoMarker) {
  Frame frame;
  frame.width_px = 64;
  frame.height_px = 16;
  frame.stride_bytes = 256;
  auto pixels = std::make_shared<std::uint8_t[]>(256 * 16);
  std::fill_n(pixels.get(), 256 * 16, std::uint8_t{128});
  frame.pixels = pixels;
  EXPECT_THROW(read_marker(frame, Marker::Lines), Error);
}

/// Two periods of three slots; every picture of slot n is n everywhere, 100 + n in its red channel for the
/// second camera.
std::shared_ptr<const Footage> six_slots() {
  auto footage = std::make_shared<Footage>();
  footage->cameras = {"grey", "colour"};
  footage->patterns = {0b0010, 0b0100, 0};
  footage->slots_per_second = 1000;
  const auto names = std::make_shared<const std::vector<std::string>>(
      std::vector<std::string>{"colour", "grey"});  // another order than the footage's
  for (std::uint8_t slot = 0; slot < 6; ++slot) {
    FrameSet set;
    set.slot = slot;
    set.camera_names = names;
    for (const bool colour : {true, false}) {
      auto pixels = std::make_shared<std::uint8_t[]>(4 * 64 * 16);
      for (std::ptrdiff_t i = 0; i < 64 * 16; ++i) {
        pixels[4 * i] = static_cast<std::uint8_t>(slot + (colour ? 100 : 0));
        pixels[4 * i + 1] = pixels[4 * i + 2] = slot;
        pixels[4 * i + 3] = 255;
      }
      Frame& frame = set.frames.emplace_back();
      frame.width_px = 64;
      frame.height_px = 16;
      frame.stride_bytes = 4 * 64;
      frame.pixels = std::move(pixels);
    }
    footage->add(set);
  }
  return footage;
}

TEST(SimulatedDevices, FootageIsChosenByLinesAndClock) {
  SimulatedDevices rig(kCameras, kProjectors, six_slots());
  const auto grey = rig.camera({"grey", 1, 1, 30}, true);
  const auto colour = rig.camera({"colour", 1, 1, 30}, true);
  EXPECT_EQ(grey->info().width_px, 64);
  grey->start();
  colour->start();
  const std::int64_t begun_ns = now_ns();
  const auto shot = [&](LineMask lines, int slot) {
    rig.on_change(0, begun_ns);
    rig.on_change(lines | kCameras, begun_ns + slot * 1'000'000);
    Frame left;
    Frame right;
    EXPECT_EQ(grey->next(left, 1s), CaptureOutcome::Delivered);
    EXPECT_EQ(colour->next(right, 1s), CaptureOutcome::Delivered);
    EXPECT_EQ(left.row(7)[4 * 31 + 3], 255);
    if (lines != kProjectors) {
      EXPECT_EQ(right.row(7)[4 * 31], left.row(7)[4 * 31] + 100);
      EXPECT_EQ(right.row(7)[4 * 31 + 2], left.row(7)[4 * 31]);
    }
    return static_cast<int>(left.row(7)[4 * 31]);
  };
  EXPECT_EQ(shot(0b0100, 0), 1) << "before the first period the lines choose within it";
  EXPECT_EQ(shot(0b0010, 0), 0) << "here it begins";
  EXPECT_EQ(shot(0b0100, 1), 1);
  EXPECT_EQ(shot(0, 2), 2);
  EXPECT_EQ(shot(0b0010, 3), 3) << "the second period, by the clock";
  EXPECT_EQ(shot(0, 4), 5) << "a blank picture where the lines show none, whichever slot it should be";
  EXPECT_EQ(shot(0b0010, 60), 3) << "after its end the last period is seen";
}

TEST(SimulatedDevices, LinesThatTheFootageDoesNotKnowShowNothing) {
  SimulatedDevices rig(kCameras, kProjectors, six_slots());
  const auto camera = rig.camera({"grey", 1, 1, 30}, true);
  camera->start();
  rig.on_change(kProjectors | kCameras, now_ns());
  Frame frame;
  ASSERT_EQ(camera->next(frame, 1s), CaptureOutcome::Delivered);
  EXPECT_EQ(frame.row(7)[4 * 31], 0);
  EXPECT_THROW(rig.camera({"nobody", 1, 1, 30}, true), Error);
}

}  // namespace
}  // namespace facet::simulated
