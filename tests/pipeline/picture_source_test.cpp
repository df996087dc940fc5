#include "pipeline/picture_source.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>
#include <utility>

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::HasSubstr;

/// Hands out frames of these numbers, one a call; a negative one is a Timeout.
class ListedCamera final : public Camera {
 public:
  ListedCamera(std::string name, std::deque<int> numbers)
      : name_(std::move(name)), numbers_(std::move(numbers)) {}

  CameraInfo info() const override {
    CameraInfo info;
    info.name = name_;
    return info;
  }
  CameraStatus status() const override { return {CameraState::Streaming, name_, {}}; }
  void start() override {}
  CaptureOutcome next(Frame& out, std::chrono::milliseconds /*timeout*/) override {
    if (numbers_.empty()) {
      return CaptureOutcome::EndOfStream;
    }
    const int number = numbers_.front();
    numbers_.pop_front();
    if (number < 0) {
      return CaptureOutcome::Timeout;
    }
    out.sequence = static_cast<std::uint64_t>(number);
    out.timestamp_ns = number * 10;
    out.media_time_ns = number;
    out.pixels = std::make_shared<std::uint8_t[]>(4);
    return CaptureOutcome::Delivered;
  }
  void stop() override {}
  std::string last_error() const override { return numbers_.empty() ? name_ + " is at its end" : ""; }

 private:
  std::string name_;
  std::deque<int> numbers_;
};

std::unique_ptr<PictureSource> in_step(const std::vector<std::deque<int>>& numbers) {
  std::vector<std::unique_ptr<Camera>> cameras;
  for (const std::deque<int>& one : numbers) {
    cameras.push_back(
        std::make_unique<ListedCamera>(std::string(1, static_cast<char>('a' + cameras.size())), one));
  }
  return cameras_in_step(std::move(cameras));
}

std::vector<std::uint64_t> numbers_of(const FrameSet& set) {
  std::vector<std::uint64_t> numbers;
  for (const Frame& frame : set.frames) {
    numbers.push_back(frame.sequence);
  }
  return numbers;
}

TEST(CamerasInStep, OneCameraIsASetOfOne) {
  const auto source = one_camera(std::make_unique<ListedCamera>("a", std::deque{-1, 4}));
  ASSERT_EQ(source->cameras().size(), 1U);
  EXPECT_EQ(source->cameras().front().info.name, "a");
  EXPECT_FALSE(source->cameras().front().camera_from_reference.has_value());
  EXPECT_EQ(source->status().reason, "a");
  FrameSet set;
  set.slot = 99;
  EXPECT_EQ(source->next(set, 1ms), CaptureOutcome::Timeout);
  EXPECT_EQ(set.slot, 99U) << "nothing came";
  ASSERT_EQ(source->next(set, 1ms), CaptureOutcome::Delivered);
  EXPECT_EQ(set.slot, 4U);
  EXPECT_EQ(set.trigger_ns, 40);
  EXPECT_EQ(set.media_time_ns, 4);
  EXPECT_TRUE(set.complete());
  EXPECT_THAT(numbers_of(set), ElementsAre(4));
  EXPECT_EQ(source->next(set, 1ms), CaptureOutcome::EndOfStream);
  EXPECT_EQ(source->last_error(), "a is at its end");
}

TEST(CamerasInStep, AMomentIsReadOnWhereACameraLetsItWait) {
  // The second camera begins earlier, the third keeps the others waiting.
  const auto source = in_step({{2, 3}, {0, 1, 2, 3}, {-1, 2, -1, -1, 3}});
  FrameSet set;
  EXPECT_EQ(source->next(set, 1ms), CaptureOutcome::Timeout);
  ASSERT_EQ(source->next(set, 1ms), CaptureOutcome::Delivered);
  EXPECT_THAT(numbers_of(set), ElementsAre(2, 2, 2));
  EXPECT_EQ(source->next(set, 1ms), CaptureOutcome::Timeout);
  EXPECT_EQ(source->next(set, 1ms), CaptureOutcome::Timeout);
  ASSERT_EQ(source->next(set, 1ms), CaptureOutcome::Delivered);
  EXPECT_THAT(numbers_of(set), ElementsAre(3, 3, 3));
  EXPECT_EQ(source->next(set, 1ms), CaptureOutcome::EndOfStream);
}

TEST(CamerasInStep, AFrameThatACameraLacksIsAFailureThatNamesIt) {
  for (const std::deque<int>& lacking : {std::deque<int>{0}, std::deque<int>{0, 2}}) {
    const auto source = in_step({{0, 1, 2}, lacking});
    FrameSet set;
    ASSERT_EQ(source->next(set, 1ms), CaptureOutcome::Delivered);
    EXPECT_EQ(source->next(set, 1ms), CaptureOutcome::Failed);
    EXPECT_THAT(source->last_error(),
                HasSubstr("'b' has no frame 1, which the first camera has (b is at its end)"));
  }
}

TEST(PicturesOf, AreThoseOfTheNamedCamerasAndAllOfTheSetsSlot) {
  FrameSet set;
  set.slot = 7;
  set.trigger_ns = 70;
  set.media_time_ns = 20;
  set.camera_names =
      std::make_shared<const std::vector<std::string>>(std::vector<std::string>{"x", "y", "z"});
  set.frames.resize(3);
  set.missing = 2;
  for (const std::size_t there : {0U, 2U}) {
    set.frames[there].width_px = static_cast<int>(there) + 1;
    set.frames[there].pixels = std::make_shared<std::uint8_t[]>(4);
  }
  std::vector<PictureCamera> cameras(3);
  cameras[0].info.name = "z";
  cameras[1].info.name = "y";
  cameras[1].info.width_px = 640;
  cameras[1].info.height_px = 480;
  cameras[2].info.name = "none";
  const FrameSet out = pictures_of(set, cameras);
  EXPECT_EQ(out.slot, 7U);
  EXPECT_EQ(out.missing, 6U);
  ASSERT_EQ(out.frames.size(), 3U);
  EXPECT_EQ(out.frames[0].pixels, set.frames[2].pixels);
  EXPECT_TRUE(out.frames[1].empty());
  EXPECT_EQ(out.frames[1].width_px, 640);
  EXPECT_EQ(out.frames[1].height_px, 480);
  for (const Frame& frame : out.frames) {
    EXPECT_EQ(frame.sequence, 7U);
    EXPECT_EQ(frame.timestamp_ns, 70);
    EXPECT_EQ(frame.media_time_ns, 20);
  }
  set.camera_names = nullptr;
  EXPECT_EQ(pictures_of(set, cameras).missing, 7U);
}

}  // namespace
}  // namespace facet::pipeline
