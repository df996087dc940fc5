#include "camera/turned_camera.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "facet/error.hpp"

namespace facet::camera {
namespace {

using ::testing::HasSubstr;

constexpr int kWidth = 37;  // more than two tiles, and no whole number of them
constexpr int kHeight = 21;

/// One picture whose pixels tell where they are: R is x, G is y.
class Telling final : public Camera {
 public:
  CameraInfo info() const override {
    CameraInfo info;
    info.width_px = kWidth;
    info.height_px = kHeight;
    info.intrinsics = CameraIntrinsics{50, 60, 10, 8, kWidth, kHeight};
    return info;
  }
  CameraStatus status() const override { return {}; }
  void start() override {}
  CaptureOutcome next(Frame& out, std::chrono::milliseconds /*timeout*/) override {
    constexpr int kStride = 4 * kWidth + 12;
    const std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[kStride * kHeight]());
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        std::uint8_t* pixel = pixels.get() + y * kStride + 4 * x;
        pixel[0] = static_cast<std::uint8_t>(x);
        pixel[1] = static_cast<std::uint8_t>(y);
        pixel[3] = 255;
      }
    }
    out = {};
    out.sequence = 9;
    out.timestamp_ns = 5;
    out.corrupt = true;
    out.width_px = kWidth;
    out.height_px = kHeight;
    out.stride_bytes = kStride;
    out.pixels = pixels;
    return CaptureOutcome::Delivered;
  }
  void stop() override {}
  std::string last_error() const override { return ""; }
};

struct Case {
  PictureTurn turn;
  /// Where the given picture's top left pixel and the one right of it come out.
  std::pair<int, int> corner, beside;
};

class Turns : public ::testing::TestWithParam<Case> {};

TEST_P(Turns, EveryPixelComesToItsPlaceAndTheIntrinsicsWithIt) {
  const auto& [turn, corner, beside] = GetParam();
  const std::unique_ptr<Camera> camera = turn_pictures(std::make_unique<Telling>(), turn);
  Frame frame;
  ASSERT_EQ(camera->next(frame, {}), CaptureOutcome::Delivered);
  const bool swapped = turn.clockwise_deg % 180 != 0;
  EXPECT_EQ(frame.width_px, swapped ? kHeight : kWidth);
  EXPECT_EQ(frame.height_px, swapped ? kWidth : kHeight);
  EXPECT_EQ(camera->info().width_px, frame.width_px);
  EXPECT_EQ(camera->info().height_px, frame.height_px);
  EXPECT_EQ(frame.sequence, 9U);
  EXPECT_EQ(frame.timestamp_ns, 5);
  EXPECT_TRUE(frame.corrupt);

  // The turn is a rigid one: two pixels tell where all of them come to, and every one does, once.
  const int right_x = beside.first - corner.first;
  const int right_y = beside.second - corner.second;
  const int hand = turn.mirror ? -1 : 1;
  const int down_x = -hand * right_y;
  const int down_y = hand * right_x;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const int column = corner.first + x * right_x + y * down_x;
      const int row = corner.second + x * right_y + y * down_y;
      ASSERT_TRUE(column >= 0 && column < frame.width_px && row >= 0 && row < frame.height_px);
      const std::uint8_t* pixel = frame.row(row) + 4 * column;
      ASSERT_EQ(pixel[0], x) << column << ", " << row;
      ASSERT_EQ(pixel[1], y);
      ASSERT_EQ(pixel[3], 255);
    }
  }
  // The centre of view is a place in the picture like any other.
  const CameraIntrinsics seen = *camera->info().intrinsics;
  const std::uint8_t* centre = frame.row(static_cast<int>(seen.cy)) + 4 * static_cast<int>(seen.cx);
  EXPECT_EQ(centre[0], 10);
  EXPECT_EQ(centre[1], 8);
  EXPECT_EQ(seen.fx, swapped ? 60 : 50);
  EXPECT_EQ(seen.fy, swapped ? 50 : 60);
  EXPECT_EQ(seen.width_px, frame.width_px);
}

INSTANTIATE_TEST_SUITE_P(
    AllEight, Turns,
    ::testing::Values(Case{{0, false}, {0, 0}, {1, 0}}, Case{{90, false}, {kHeight - 1, 0}, {kHeight - 1, 1}},
                      Case{{180, false}, {kWidth - 1, kHeight - 1}, {kWidth - 2, kHeight - 1}},
                      Case{{270, false}, {0, kWidth - 1}, {0, kWidth - 2}},
                      Case{{0, true}, {kWidth - 1, 0}, {kWidth - 2, 0}}, Case{{90, true}, {0, 0}, {0, 1}},
                      Case{{180, true}, {0, kHeight - 1}, {1, kHeight - 1}},
                      Case{{270, true}, {kHeight - 1, kWidth - 1}, {kHeight - 1, kWidth - 2}}));

TEST(TurnedCamera, OtherAnglesAreRefused) {
  for (const int angle : {-90, 1, 45, 360}) {
    try {
      turn_pictures(std::make_unique<Telling>(), {angle, false});
      ADD_FAILURE() << angle;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      EXPECT_THAT(error.what(), HasSubstr("0, 90, 180 or 270"));
    }
  }
}

TEST(TurnedCamera, APlainOneIsTheCameraItself) {
  auto given = std::make_unique<Telling>();
  const Camera* before = given.get();
  EXPECT_EQ(turn_pictures(std::move(given), {}).get(), before);
}

}  // namespace
}  // namespace facet::camera
