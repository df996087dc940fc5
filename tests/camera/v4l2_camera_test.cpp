#include "camera/v4l2_camera.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "camera/v4l2_controls.hpp"
#include "facet/error.hpp"
#include "fake_v4l2.hpp"
#include "support/jpeg_picture.hpp"
#include "support/paths.hpp"

namespace facet::camera {
namespace {

using namespace std::chrono_literals;
using test::kMillisecond_ns;
using test::kSecond_ns;
using testing::AllOf;
using testing::HasSubstr;

/// A camera of 4 x 2 grey pixels at 10 Hz, unless a test says otherwise.
class V4l2CameraTest : public testing::Test {
 protected:
  V4l2CameraTest() {
    config_.device = "/dev/video0";
    config_.width_px = 4;
    config_.height_px = 2;
    config_.rate_hz = 10;
  }
  ~V4l2CameraTest() override {
    camera_.reset();
    EXPECT_EQ(device_.open_count(), 0U);
    EXPECT_EQ(device_.mapped, 0);
  }

  Camera& open() {
    camera_ = open_v4l2_camera(config_, device_);
    return *camera_;
  }
  Camera& started() {
    open().start();
    return *camera_;
  }
  /// The next frame, for which everything is well.
  Frame next(std::chrono::milliseconds patience = 10s) {
    Frame frame;
    EXPECT_EQ(camera_->next(frame, patience), CaptureOutcome::Delivered) << camera_->last_error();
    return frame;
  }
  /// Calls next until it says Timeout, which it does at once when something breaks.
  void expect_fault(CameraState state, const std::string& reason) {
    Frame frame;
    for (int i = 0; i < 10 && camera_->next(frame, 10s) == CaptureOutcome::Delivered; ++i) {
    }
    EXPECT_EQ(status().state, state) << to_string(status().state);
    EXPECT_THAT(status().reason, HasSubstr(reason));
    EXPECT_THAT(camera_->last_error(), HasSubstr(reason));
    // What was unplugged is closed a moment later.
    for (int i = 0; i < 10 && state == CameraState::Absent && device_.open_count() > 0; ++i) {
      camera_->next(frame, 50ms);
    }
    EXPECT_EQ(device_.open_count(), 0U) << "a broken device is let go";
  }
  /// Calls next until a frame comes; how long that took, on the device's clock.
  std::int64_t recover(Frame& frame) {
    const std::int64_t begun_ns = device_.now_ns;
    for (int i = 0; i < 1000; ++i) {
      if (camera_->next(frame, 50ms) == CaptureOutcome::Delivered) {
        EXPECT_EQ(status().state, CameraState::Streaming);
        EXPECT_EQ(status().reason, "");
        return device_.now_ns - begun_ns;
      }
    }
    ADD_FAILURE() << "never delivers again: " << camera_->last_error();
    return 0;
  }
  CameraStatus status() const { return camera_->status(); }
  CameraCounters counters() const { return camera_->status().counters; }
  std::string refusal() {
    try {
      open();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Usage);
      return error.what();
    }
    return "no error";
  }

  test::FakeV4l2 device_;
  LiveConfig config_;
  std::unique_ptr<Camera> camera_;
};

TEST_F(V4l2CameraTest, DeliversFramesWithTheDriversTimesAndNumbers) {
  device_.on_fill = [](test::FakeV4l2::Filled& filled) {
    filled.bytes.assign({1, 2, 3, 4, 5, 6, 7, static_cast<std::uint8_t>(8 + filled.sequence)});
  };
  Camera& camera = open();
  EXPECT_EQ(status().state, CameraState::Idle);
  EXPECT_EQ(camera.info().name, "/dev/video0 (Fake Camera)");
  EXPECT_EQ(camera.info().width_px, 4);
  EXPECT_EQ(camera.info().height_px, 2);
  EXPECT_TRUE(camera.info().live);
  EXPECT_EQ(device_.open_count(), 0U);
  camera.start();
  Frame frame;
  EXPECT_EQ(camera.next(frame, 0ms), CaptureOutcome::Timeout);
  EXPECT_EQ(status().state, CameraState::Opening);
  for (std::uint64_t i = 0; i < 10; ++i) {
    frame = next();
    EXPECT_EQ(status().state, CameraState::Streaming);
    EXPECT_EQ(frame.sequence, i);
    EXPECT_EQ(frame.timestamp_ns, device_.now_ns - device_.period_ns);
    EXPECT_EQ(frame.media_time_ns, static_cast<std::int64_t>(i) * device_.period_ns);
    EXPECT_EQ(frame.width_px, 4);
    EXPECT_EQ(frame.height_px, 2);
    EXPECT_FALSE(frame.corrupt);
    EXPECT_EQ(frame.row(0)[0], 1);
    EXPECT_EQ(frame.row(0)[3], 255);
    EXPECT_EQ(frame.row(1)[4 * 3 + 2], 8 + i);
  }
  EXPECT_EQ(counters().delivered, 10U);
  for (const CameraCount& count : kCameraCounts) {
    EXPECT_EQ(counters().*count.value, std::string(count.name) == "delivered" ? 10U : 0U) << count.name;
  }
  camera.stop();
  EXPECT_EQ(camera.next(frame, 1s), CaptureOutcome::EndOfStream);
  EXPECT_EQ(status().state, CameraState::Idle);
  EXPECT_FALSE(device_.streaming());
}

TEST_F(V4l2CameraTest, WaitsNoLongerThanAsked) {
  device_.silent = true;
  started();
  const std::int64_t before_ns = device_.now_ns;
  Frame frame;
  EXPECT_EQ(camera_->next(frame, 30ms), CaptureOutcome::Timeout);
  EXPECT_EQ(device_.now_ns - before_ns, 30 * kMillisecond_ns);
}

TEST_F(V4l2CameraTest, UsesTheBuffersOfTheConfiguration) {
  config_.buffers = 7;
  started();
  next();
  EXPECT_EQ(device_.buffer_count(), 7U);
}

TEST_F(V4l2CameraTest, ALateReaderGetsTheNewestFrameAndTheOthersAreCounted) {
  started();
  next();
  device_.run_until(device_.now_ns + 350 * kMillisecond_ns);
  const Frame frame = next();
  EXPECT_EQ(frame.sequence, 3U);
  EXPECT_EQ(counters().skipped, 2U);
  EXPECT_EQ(counters().lost, 0U);
  EXPECT_EQ(next().sequence, 4U);
}

TEST_F(V4l2CameraTest, WithoutAFreeBufferTheDriversLossesAreCounted) {
  started();
  next();
  device_.run_until(device_.now_ns + 1050 * kMillisecond_ns);  // 10 frames for 4 buffers
  EXPECT_EQ(next().sequence, 4U);
  EXPECT_EQ(next().sequence, 11U);
  EXPECT_EQ(counters().skipped, 3U);
  EXPECT_EQ(counters().lost, 6U);
  EXPECT_EQ(counters().delivered, 3U);
}

TEST_F(V4l2CameraTest, FramesKeepTheirPixelsWhileLaterOnesCome) {
  std::uint8_t value = 0;
  device_.on_fill = [&](test::FakeV4l2::Filled& filled) { filled.bytes.assign(8, ++value); };
  started();
  std::vector<Frame> kept;
  for (int i = 0; i < 12; ++i) {
    kept.push_back(next());
  }
  for (std::size_t i = 0; i < kept.size(); ++i) {
    EXPECT_EQ(kept[i].row(1)[0], i + 1);
  }
}

// Formats. Each matrix and range is checked in pixel_conversion_test; here, that what the driver says is
// followed.

struct Wire {
  const char* format;
  std::uint32_t fourcc;
  std::vector<std::uint8_t> bytes;  ///< two rows of four pixels, each row padded by four bytes
  std::array<int, 3> first_pixel;
};

class V4l2FormatTest : public V4l2CameraTest, public testing::WithParamInterface<Wire> {
 protected:
  void expect_delivered(const Wire& wire) {
    config_.format = wire.format;
    device_.modes = {{V4L2_PIX_FMT_UYVY, 4, 2, {10}}, {wire.fourcc, 4, 2, {10}}};
    device_.row_padding_bytes = 4;
    device_.on_fill = [&](test::FakeV4l2::Filled& filled) { filled.bytes = wire.bytes; };
    started();
    const Frame frame = next();
    for (int y = 0; y < 2; ++y) {
      for (std::size_t channel = 0; channel < 3; ++channel) {
        EXPECT_EQ(frame.row(y)[channel], wire.first_pixel[channel]) << "row " << y << ", channel " << channel;
        EXPECT_EQ(frame.row(y)[12 + channel], wire.first_pixel[channel])
            << "row " << y << ", channel " << channel;
      }
    }
  }
};

TEST_P(V4l2FormatTest, IsDelivered) {
  expect_delivered(GetParam());
}

TEST_P(V4l2FormatTest, IsDeliveredByAMultiPlanarDevice) {
  device_.capabilities = V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING;
  device_.data_offset = 32;
  expect_delivered(GetParam());
}

INSTANTIATE_TEST_SUITE_P(
    AllOfThem, V4l2FormatTest,
    testing::Values(Wire{"YUYV",
                         V4L2_PIX_FMT_YUYV,
                         {81, 90, 81, 240, 81, 90, 81, 240, 0, 0, 0, 0, 81, 90, 81, 240, 81, 90, 81, 240},
                         {254, 0, 0}},
                    Wire{"NV12",
                         V4L2_PIX_FMT_NV12,
                         {81, 81, 81, 81, 0, 0, 0, 0, 81, 81, 81, 81, 0, 0, 0, 0, 90, 240, 90, 240},
                         {254, 0, 0}},
                    Wire{"GREY", V4L2_PIX_FMT_GREY, {9, 9, 9, 9, 0, 0, 0, 0, 9, 9, 9, 9}, {9, 9, 9}},
                    Wire{"Y10",
                         V4L2_PIX_FMT_Y10,
                         {0, 2, 0, 2, 0, 2, 0, 2, 0, 0, 0, 0, 0, 2, 0, 2, 0, 2, 0, 2},
                         {128, 128, 128}},
                    Wire{"Y16",
                         V4L2_PIX_FMT_Y16,
                         {0, 64, 0, 64, 0, 64, 0, 64, 0, 0, 0, 0, 0, 64, 0, 64, 0, 64, 0, 64},
                         {64, 64, 64}}),
    [](const auto& wire) { return wire.param.format; });

class V4l2MultiPlanarTest : public V4l2CameraTest {
 protected:
  V4l2MultiPlanarTest() {
    device_.capabilities = V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING;
    device_.modes = {{V4L2_PIX_FMT_NV12, 4, 2, {30}}, {V4L2_PIX_FMT_NV12M, 4, 2, {10, 30}}};
    device_.on_fill = [this](test::FakeV4l2::Filled& filled) {
      filled.bytes = {81, 81, 81, 81, 81, 81, 81, 81, 90, 240, 90, 240};
      if (spoil_) {
        spoil_(filled);
        spoil_ = nullptr;
      }
    };
  }
  std::function<void(test::FakeV4l2::Filled&)> spoil_;  ///< changes the next picture alone
};

TEST_F(V4l2MultiPlanarTest, Nv12InTwoBlocksOfMemory) {
  for (const std::uint32_t offset : {0U, 32U}) {
    device_.data_offset = offset;
    started();
    for (std::uint64_t i = 0; i < 10; ++i) {
      const Frame frame = next();
      EXPECT_EQ(frame.sequence, i);
      EXPECT_EQ(frame.timestamp_ns, device_.now_ns - device_.period_ns);
      for (int y = 0; y < 2; ++y) {
        EXPECT_EQ(frame.row(y)[0], 254);
        EXPECT_EQ(frame.row(y)[13], 0);
      }
    }
    EXPECT_EQ(device_.mapped, 8) << "two of each buffer";
    camera_->stop();
    EXPECT_EQ(device_.mapped, 0);
  }
}

TEST_F(V4l2MultiPlanarTest, EachBlockMustBeWhole) {
  started();
  next();
  spoil_ = [](test::FakeV4l2::Filled& filled) { filled.bytes.pop_back(); };
  next();
  EXPECT_EQ(counters().truncated, 1U);
  spoil_ = [](test::FakeV4l2::Filled& filled) { filled.bytes.resize(7); };
  next();
  EXPECT_EQ(counters().truncated, 2U);
  spoil_ = [](test::FakeV4l2::Filled& filled) { filled.bytes.resize(1000); };
  next();
  EXPECT_EQ(counters().truncated, 3U) << "more than the memory of the second block";
  EXPECT_EQ(counters().delivered, 4U);
}

TEST_F(V4l2MultiPlanarTest, AFormatThatIsThereInBothWaysIsNamedOnce) {
  device_.modes = {{V4L2_PIX_FMT_NV12, 4, 2, {30}}, {V4L2_PIX_FMT_NV12M, 4, 2, {30}}};
  EXPECT_THAT(refusal(), testing::EndsWith("the device has: NV12 4x2 at 30 Hz"));
}

TEST_F(V4l2MultiPlanarTest, ComesBackAfterFaults) {
  started();
  next();
  device_.break_stream();
  expect_fault(CameraState::Failing, "Input/output error");
  Frame frame;
  recover(frame);
  device_.map_failures = 1;
  device_.break_stream();
  expect_fault(CameraState::Failing, "Input/output error");
  recover(frame);
  EXPECT_EQ(device_.mapped, 8);
}

TEST_F(V4l2MultiPlanarTest, OtherBlocksAreRefused) {
  device_.planes_given = 3;
  started();
  expect_fault(CameraState::Failing, "gives NV12 in 3 blocks of memory");
  camera_.reset();
  device_.planes_given = 0;
  device_.chroma_row_padding_bytes = 4;
  started();
  expect_fault(CameraState::Failing, "or with other rows in each");
}

class V4l2ColourTest : public V4l2CameraTest {
 protected:
  V4l2ColourTest() {
    device_.modes = {{V4L2_PIX_FMT_YUYV, 4, 2, {10}}};
    device_.on_fill = [](test::FakeV4l2::Filled& filled) {
      for (std::size_t i = 0; i < filled.bytes.size(); i += 4) {
        filled.bytes[i] = filled.bytes[i + 2] = 81;
        filled.bytes[i + 1] = 90;
        filled.bytes[i + 3] = 240;
      }
    };
  }
  std::array<int, 3> first_pixel() {
    started();
    const Frame frame = next();
    return {frame.row(0)[0], frame.row(0)[1], frame.row(0)[2]};
  }
};

// By hand, as in pixel_conversion_test.
TEST_F(V4l2ColourTest, Rec709) {
  device_.colorspace = V4L2_COLORSPACE_REC709;
  EXPECT_EQ(first_pixel(), (std::array{255, 24, 0}));
}

TEST_F(V4l2ColourTest, AnEncodingThatTheDriverNamesCountsMoreThanItsColourSpace) {
  device_.colorspace = V4L2_COLORSPACE_REC709;
  device_.ycbcr_enc = V4L2_YCBCR_ENC_601;
  EXPECT_EQ(first_pixel(), (std::array{254, 0, 0}));
}

// 81 + 1.402 112 = 238.0; 81 + 0.344136 38 - 0.714136 112 = 14.1; 81 - 1.772 38 = 13.7
TEST_F(V4l2ColourTest, FullRange) {
  device_.quantization = V4L2_QUANTIZATION_FULL_RANGE;
  EXPECT_EQ(first_pixel(), (std::array{238, 14, 14}));
}

TEST_F(V4l2ColourTest, TheColourSpaceOfJpegHasFullRange) {
  device_.colorspace = V4L2_COLORSPACE_JPEG;
  EXPECT_EQ(first_pixel(), (std::array{238, 14, 14}));
}

TEST_F(V4l2CameraTest, GreyOfLimitedRangeWhereTheDriverSaysSo) {
  device_.quantization = V4L2_QUANTIZATION_LIM_RANGE;
  device_.on_fill = [](test::FakeV4l2::Filled& filled) { filled.bytes.assign(8, 128); };
  started();
  EXPECT_EQ(next().row(0)[0], 130);
}

class V4l2JpegTest : public V4l2CameraTest {
 protected:
  V4l2JpegTest() {
    config_.width_px = 16;
    config_.height_px = 16;
    device_.modes = {{V4L2_PIX_FMT_MJPEG, 16, 16, {10}}};
    device_.on_fill = [this](test::FakeV4l2::Filled& filled) {
      filled.bytes = test::jpeg_of({200, 100, 50}, 16, 16);
      if (spoil_) {
        spoil_(filled);
        spoil_ = nullptr;
      }
    };
  }
  std::function<void(test::FakeV4l2::Filled&)> spoil_;  ///< what happens to the next frame
};

TEST_F(V4l2JpegTest, IsDecoded) {
  started();
  const Frame frame = next();
  EXPECT_NEAR(frame.row(8)[32], 200, 2);
  EXPECT_NEAR(frame.row(8)[33], 100, 2);
  EXPECT_NEAR(frame.row(8)[34], 50, 2);
  EXPECT_EQ(frame.row(8)[35], 255);
}

TEST_F(V4l2JpegTest, APictureCutShortIsDeliveredAsDamaged) {
  spoil_ = [](test::FakeV4l2::Filled& filled) { filled.bytes.resize(filled.bytes.size() - 8); };
  started();
  EXPECT_TRUE(next().corrupt);
  EXPECT_FALSE(next().corrupt);
  EXPECT_EQ(counters().damaged, 1U);
  EXPECT_EQ(counters().delivered, 2U);
}

TEST_F(V4l2JpegTest, WhatIsNoPictureIsCountedAndLeftOut) {
  spoil_ = [](test::FakeV4l2::Filled& filled) { filled.bytes.assign(500, 0x11); };
  started();
  EXPECT_EQ(next().sequence, 1U);
  EXPECT_EQ(counters().undecodable, 1U);
  spoil_ = [](test::FakeV4l2::Filled& filled) { filled.bytes.clear(); };
  EXPECT_EQ(next().sequence, 3U);
  EXPECT_EQ(counters().truncated, 1U);
  EXPECT_EQ(counters().delivered, 2U);
}

// Single bad frames.

TEST_F(V4l2CameraTest, AFrameThatTheDriverMarksIsDeliveredAsDamaged) {
  device_.on_fill = [](test::FakeV4l2::Filled& filled) {
    filled.flags |= filled.sequence == 1 ? V4L2_BUF_FLAG_ERROR : 0;
  };
  started();
  EXPECT_FALSE(next().corrupt);
  EXPECT_TRUE(next().corrupt);
  EXPECT_FALSE(next().corrupt);
  EXPECT_EQ(counters().damaged, 1U);
}

TEST_F(V4l2CameraTest, AShortFrameIsLeftOut) {
  device_.on_fill = [](test::FakeV4l2::Filled& filled) {
    if (filled.sequence == 1) {
      filled.bytes.resize(7);
    } else if (filled.sequence == 2) {
      filled.bytes.resize(9);  // more than the buffer holds
    }
  };
  started();
  EXPECT_EQ(next().sequence, 0U);
  EXPECT_EQ(next().sequence, 3U);
  EXPECT_EQ(counters().truncated, 2U);
  EXPECT_EQ(counters().lost, 0U);
}

TEST_F(V4l2CameraTest, GapsOfTheDriversNumbersAreLosses) {
  device_.on_fill = [](test::FakeV4l2::Filled& filled) {
    filled.dropped = filled.sequence == 2 || filled.sequence == 3;
  };
  started();
  EXPECT_EQ(next().sequence, 0U);
  EXPECT_EQ(next().sequence, 1U);
  EXPECT_EQ(next().sequence, 4U);
  EXPECT_EQ(counters().lost, 2U);
  EXPECT_EQ(counters().omitted, 0U) << "what the numbers tell is not counted twice";
}

TEST_F(V4l2CameraTest, FramesThatTheDeviceLeavesOutShowInTheTimes) {
  started();
  next();
  device_.silent = true;
  device_.run_until(device_.now_ns + 350 * kMillisecond_ns);
  device_.silent = false;
  EXPECT_EQ(next().sequence, 1U);
  EXPECT_EQ(counters().omitted, 0U) << "it may have been stamped late";
  EXPECT_EQ(next().sequence, 2U);
  EXPECT_EQ(counters().omitted, 3U);
  for (int i = 0; i < 20; ++i) {
    next();
  }
  EXPECT_EQ(counters().omitted, 3U);
  EXPECT_EQ(counters().lost, 0U);
}

TEST_F(V4l2CameraTest, ADeviceThatSlowsDownLeavesFramesOut) {
  started();
  next();
  device_.period_ns = 150 * kMillisecond_ns;  // of 100
  for (int i = 0; i < 101; ++i) {
    next();
  }
  EXPECT_NEAR(static_cast<double>(counters().omitted), 50, 2);
}

TEST_F(V4l2CameraTest, TimesThatComeLateNowAndThenAreNoOmissions) {
  // As a driver stamps whose thread runs on a busy machine: up to 0.6 periods late, the first one early.
  device_.on_fill = [](test::FakeV4l2::Filled& filled) {
    constexpr std::array kLate_ms = {0, 10, 55, 5, 40, 0, 60, 30};
    filled.stamp_ns -= (70 - kLate_ms.at(filled.sequence % kLate_ms.size())) * kMillisecond_ns;
  };
  started();
  for (int i = 0; i < 100; ++i) {
    next();
  }
  EXPECT_EQ(counters().omitted, 0U);
}

TEST_F(V4l2CameraTest, ACameraThatIsALittleSlowerThanItSaysLeavesNothingOut) {
  started();
  next();
  device_.period_ns = 100 * kMillisecond_ns + 100'000;
  for (int i = 0; i < 2000; ++i) {
    next();
  }
  EXPECT_EQ(counters().omitted, 0U);
}

TEST_F(V4l2CameraTest, TheDriversNumbersMayWrap) {
  device_.first_sequence = 0xFFFFFFFE;
  device_.on_fill = [](test::FakeV4l2::Filled& filled) { filled.dropped = filled.sequence == 1; };
  started();
  for (const std::uint64_t expected : {0U, 1U, 2U, 4U}) {
    EXPECT_EQ(next().sequence, expected);
  }
  EXPECT_EQ(counters().lost, 1U);
}

TEST_F(V4l2CameraTest, NumbersThatStandStillOrBeginAnewAreNoLosses) {
  const std::vector<std::uint32_t> numbers = {5, 5, 5, 0, 1, 900'000'000};
  std::size_t at = 0;
  device_.on_fill = [&](test::FakeV4l2::Filled& filled) { filled.sequence = numbers[at++]; };
  started();
  for (std::uint64_t expected = 0; expected < numbers.size(); ++expected) {
    EXPECT_EQ(next().sequence, expected);
  }
  EXPECT_EQ(counters().lost, 0U);
}

// Times.

TEST_F(V4l2CameraTest, FramesFromBeforeTheStreamAreLeftOut) {
  int old = 2;
  device_.on_fill = [&](test::FakeV4l2::Filled& filled) {
    filled.stamp_ns -= old-- > 0 ? 3 * kSecond_ns : 0;
  };
  started();
  EXPECT_EQ(next().sequence, 2U);
  EXPECT_EQ(counters().stale, 2U);
  EXPECT_EQ(counters().undated, 0U);
}

TEST_F(V4l2CameraTest, AClockThatIsWrongForGoodDoesNotMakeEveryFrameStale) {
  device_.stamp_offset_ns = -50 * kSecond_ns;
  started();
  const Frame frame = next();
  EXPECT_EQ(counters().stale, 4U) << "as many as there are buffers";
  EXPECT_EQ(frame.timestamp_ns, device_.now_ns - device_.period_ns) << "a period before it arrived";
  next();
  EXPECT_EQ(counters().undated, 2U);
}

TEST_F(V4l2CameraTest, ADriversClockMayWrap) {
  // As vivid does it: 16 s before the wrap of a 64-bit count of nanoseconds, then before zero.
  device_.stamp_offset_ns = (std::int64_t{1} << 62) - device_.now_ns;
  device_.on_fill = [&](test::FakeV4l2::Filled& filled) {
    filled.stamp_ns = filled.sequence < 3 ? filled.stamp_ns : -filled.stamp_ns;
  };
  started();
  std::int64_t last_ns = 0;
  for (std::uint64_t i = 0; i < 6; ++i) {
    const Frame frame = next();
    EXPECT_EQ(frame.sequence, i);
    EXPECT_GT(frame.timestamp_ns, last_ns);
    EXPECT_LE(frame.timestamp_ns, device_.now_ns);
    last_ns = frame.timestamp_ns;
  }
  EXPECT_EQ(counters().undated, 6U);
  EXPECT_EQ(counters().stale, 0U);
}

TEST_F(V4l2CameraTest, TimesOfTheFramesEndAreSetBackByAPeriod) {
  device_.buffer_flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF;
  device_.stamp_offset_ns = -7 * kMillisecond_ns;
  started();
  const Frame frame = next();
  EXPECT_EQ(frame.timestamp_ns, device_.now_ns - device_.period_ns - 7 * kMillisecond_ns);
  EXPECT_EQ(counters().undated, 0U);
}

TEST_F(V4l2CameraTest, TimesOfAnUnnamedClockAreThoseOfTheDay) {
  device_.buffer_flags = V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
  device_.stamp_offset_ns = device_.wall_offset_ns - 5 * kMillisecond_ns;
  started();
  const Frame frame = next();
  EXPECT_EQ(frame.timestamp_ns, device_.now_ns - device_.period_ns - 5 * kMillisecond_ns);
  EXPECT_EQ(counters().undated, 0U);
}

TEST_F(V4l2CameraTest, TimesNeverStepBack) {
  device_.on_fill = [](test::FakeV4l2::Filled& filled) {
    filled.stamp_ns -= filled.sequence == 5 ? 250 * kMillisecond_ns : 0;
  };
  started();
  std::int64_t last_ns = 0;
  for (int i = 0; i < 8; ++i) {
    const Frame frame = next();
    EXPECT_GT(frame.timestamp_ns, last_ns);
    last_ns = frame.timestamp_ns;
  }
}

// A device that breaks, and comes back.

TEST_F(V4l2CameraTest, AnUnpluggedDeviceComesBack) {
  started();
  next();
  Frame frame = next();
  const std::uint64_t last = frame.sequence;
  const std::int64_t unplugged_ns = device_.now_ns + 30 * kMillisecond_ns;
  device_.at(unplugged_ns, [&] { device_.unplug(); });
  EXPECT_EQ(camera_->next(frame, 10s), CaptureOutcome::Timeout);
  EXPECT_EQ(device_.now_ns, unplugged_ns) << "noticed at once";
  EXPECT_EQ(status().state, CameraState::Absent);
  EXPECT_EQ(device_.open_count(), 1U) << "not closed while the kernel takes it down";
  expect_fault(CameraState::Absent, "/dev/video0: no such device");
  device_.at(device_.now_ns + 20 * kSecond_ns, [&] { device_.present = true; });
  EXPECT_LT(recover(frame), 20 * kSecond_ns + 500 * kMillisecond_ns);
  EXPECT_EQ(frame.sequence, last + 2) << "the break shows as a gap";
  EXPECT_EQ(frame.timestamp_ns, device_.now_ns - device_.period_ns);
  EXPECT_EQ(next().sequence, last + 3);
  EXPECT_EQ(counters().reopened, 1U);
  EXPECT_EQ(counters().lost, 0U);
  EXPECT_EQ(counters().omitted, 0U);
  EXPECT_THAT(camera_->last_error(), HasSubstr("no such device"));
}

TEST_F(V4l2CameraTest, IsUnpluggedTwentyTimesWithoutALeak) {
  started();
  Frame frame = next();
  for (int i = 0; i < 20; ++i) {
    device_.at(device_.now_ns + (i * 17 % 100) * kMillisecond_ns, [&] { device_.unplug(); });
    expect_fault(CameraState::Absent, "no such device");
    EXPECT_EQ(device_.mapped, 0);
    device_.present = true;
    EXPECT_LT(recover(frame), kSecond_ns);
    EXPECT_EQ(device_.open_count(), 1U);
    EXPECT_EQ(device_.mapped, 4);
  }
  EXPECT_EQ(counters().reopened, 20U);
}

TEST_F(V4l2CameraTest, ADeviceThatIsAbsentAtTheStartIsAwaited) {
  device_.present = false;
  Camera& camera = open();
  EXPECT_EQ(status().state, CameraState::Absent);
  EXPECT_EQ(camera.info().name, "/dev/video0");
  EXPECT_EQ(camera.info().width_px, 4);
  camera.start();
  Frame frame;
  const int opens_before = device_.opens;
  const std::int64_t begun_ns = device_.now_ns;
  while (device_.now_ns < begun_ns + 60 * kSecond_ns) {
    ASSERT_EQ(camera.next(frame, 50ms), CaptureOutcome::Timeout);
    ASSERT_EQ(status().state, CameraState::Absent);
  }
  EXPECT_LE(device_.opens - opens_before, 241) << "looked for four times a second";
  device_.present = true;
  EXPECT_LT(recover(frame), 500 * kMillisecond_ns);
  EXPECT_EQ(frame.sequence, 0U);
  EXPECT_EQ(counters().reopened, 0U);
}

TEST_F(V4l2CameraTest, AStreamThatTheDriverGivesUpIsBegunAnew) {
  started();
  next();
  device_.at(device_.now_ns + 30 * kMillisecond_ns, [&] { device_.break_stream(); });
  expect_fault(CameraState::Failing, "Input/output error");
  Frame frame;
  EXPECT_LT(recover(frame), kSecond_ns);
  EXPECT_EQ(counters().reopened, 1U);
}

TEST_F(V4l2CameraTest, SilenceIsAStallAndTheDeviceIsStartedAnew) {
  config_.stall_after = 700ms;
  started();
  next();
  device_.silent = true;
  const std::int64_t silent_ns = device_.now_ns;
  expect_fault(CameraState::Stalled, "/dev/video0: no frame for 0.7 s");
  EXPECT_EQ(device_.now_ns - silent_ns, 700 * kMillisecond_ns);
  // It is started anew again and again, and stays stalled until a frame comes.
  Frame frame;
  const int opens_before = device_.opens;
  while (device_.now_ns < silent_ns + 60 * kSecond_ns) {
    ASSERT_EQ(camera_->next(frame, 50ms), CaptureOutcome::Timeout);
    ASSERT_EQ(status().state, CameraState::Stalled);
  }
  EXPECT_GT(device_.opens, opens_before + 5);
  EXPECT_LT(device_.opens, opens_before + 13);
  device_.silent = false;
  EXPECT_LT(recover(frame), 2500 * kMillisecond_ns);
  EXPECT_EQ(counters().reopened, 1U);
}

TEST_F(V4l2CameraTest, SilenceIsNoStallWhileNoFramesAreDue) {
  config_.stall_after = 700ms;
  started();
  next();
  device_.silent = true;
  camera_->expect_frames(false);
  Frame frame;
  const int opens_before = device_.opens;
  EXPECT_EQ(camera_->next(frame, 60s), CaptureOutcome::Timeout);
  EXPECT_EQ(status().state, CameraState::Streaming);
  EXPECT_EQ(device_.opens, opens_before);
  // Its trigger fires again: it goes on in the same stream, and the pause is no omission.
  camera_->expect_frames(true);
  device_.silent = false;
  for (std::uint64_t sequence = 1; sequence < 10; ++sequence) {
    EXPECT_EQ(next().sequence, sequence);
  }
  EXPECT_EQ(counters().omitted, 0U);
  EXPECT_EQ(counters().reopened, 0U);
  // And where nothing comes though it fires, it is a stall from then on.
  device_.silent = true;
  camera_->expect_frames(false);
  EXPECT_EQ(camera_->next(frame, 60s), CaptureOutcome::Timeout);
  camera_->expect_frames(true);
  const std::int64_t due_ns = device_.now_ns;
  expect_fault(CameraState::Stalled, "no frame for 60.7 s");
  EXPECT_EQ(device_.now_ns - due_ns, 700 * kMillisecond_ns);
}

TEST_F(V4l2CameraTest, ATriggeredCameraMayBeOpenLongBeforeItsTriggerFires) {
  device_.silent = true;
  started();
  camera_->expect_frames(false);
  Frame frame;
  EXPECT_EQ(camera_->next(frame, 60s), CaptureOutcome::Timeout);
  EXPECT_EQ(status().state, CameraState::Opening);
  camera_->expect_frames(true);
  const std::int64_t due_ns = device_.now_ns;
  expect_fault(CameraState::Stalled, "no frame for 65 s");
  EXPECT_EQ(device_.now_ns - due_ns, 5 * kSecond_ns) << "the patience for a first frame";
}

TEST_F(V4l2CameraTest, AStreamOfUselessFramesIsAStallToo) {
  started();
  next();
  device_.on_fill = [](test::FakeV4l2::Filled& filled) { filled.bytes.resize(3); };
  expect_fault(CameraState::Stalled, "no frame for 2 s");
  EXPECT_GE(counters().truncated, 19U);
}

TEST_F(V4l2CameraTest, ACameraThatIsNotAskedForAWhileIsNotStalled) {
  started();
  next();
  device_.run_until(device_.now_ns + 100 * kSecond_ns);
  EXPECT_EQ(next().sequence, 4U);
  EXPECT_EQ(status().state, CameraState::Streaming);
}

class V4l2RequestErrorTest : public V4l2CameraTest,
                             public testing::WithParamInterface<std::pair<const char*, unsigned long>> {};

/// Each request fails three times, with another error each time; then all is well.
TEST_P(V4l2RequestErrorTest, IsSurvived) {
  const auto& [name, request] = GetParam();
  open();
  device_.errors[request] = {EIO, EBUSY, ENOMEM};
  camera_->start();
  expect_fault(CameraState::Failing, "Input/output error");
  EXPECT_THAT(status().reason, HasSubstr(name));
  Frame frame;
  const std::int64_t took_ns = recover(frame);
  EXPECT_GE(took_ns, 1750 * kMillisecond_ns) << "pauses of 0.25, 0.5 and 1 s";
  EXPECT_LT(took_ns, 2000 * kMillisecond_ns);
  EXPECT_TRUE(device_.errors[request].empty());
  EXPECT_EQ(frame.sequence, 0U);
  // The pauses are short again after a frame.
  device_.errors[request] = {ENODEV};
  device_.at(device_.now_ns, [&] { device_.break_stream(); });
  EXPECT_LT(recover(frame), kSecond_ns);
}

INSTANTIATE_TEST_SUITE_P(
    AllOfThem, V4l2RequestErrorTest,
    testing::Values(std::pair{"QUERYCAP", VIDIOC_QUERYCAP}, std::pair{"ENUM_FMT", VIDIOC_ENUM_FMT},
                    std::pair{"S_FMT", VIDIOC_S_FMT}, std::pair{"S_PARM", VIDIOC_S_PARM},
                    std::pair{"REQBUFS", VIDIOC_REQBUFS}, std::pair{"QUERYBUF", VIDIOC_QUERYBUF},
                    std::pair{"QBUF", VIDIOC_QBUF}, std::pair{"STREAMON", VIDIOC_STREAMON},
                    std::pair{"DQBUF", VIDIOC_DQBUF}),
    [](const auto& request) { return request.param.first; });

TEST_F(V4l2CameraTest, ABufferThatCannotBeGivenBackCostsAFrame) {
  started();
  next();
  device_.errors[VIDIOC_QBUF] = {EIO};
  expect_fault(CameraState::Failing, "VIDIOC_QBUF");
  Frame frame;
  EXPECT_LT(recover(frame), kSecond_ns);
}

TEST_F(V4l2CameraTest, ABufferThatTheDriverDoesNotHaveIsAFault) {
  device_.on_fill = [](test::FakeV4l2::Filled& filled) { filled.wrong_index = filled.sequence == 1; };
  started();
  next();
  expect_fault(CameraState::Failing, "filled a buffer 1000 that it does not have");
  device_.on_fill = nullptr;
  Frame frame;
  recover(frame);
}

TEST_F(V4l2CameraTest, MemoryThatCannotBeMappedIsAFault) {
  device_.map_failures = 2;
  started();
  expect_fault(CameraState::Failing, "mmap");
  Frame frame;
  recover(frame);
}

TEST_F(V4l2CameraTest, ADriverWithTooFewBuffersIsAFault) {
  device_.most_buffers = 1;
  started();
  expect_fault(CameraState::Failing, "1 of 4 buffers");
}

TEST_F(V4l2CameraTest, ADeviceThatAnotherProgramHoldsIsAwaited) {
  device_.open_error = EACCES;
  started();
  EXPECT_EQ(status().state, CameraState::Failing);
  EXPECT_THAT(status().reason, HasSubstr("may not be opened"));
  device_.open_error = 0;
  device_.errors[VIDIOC_S_FMT] = {EBUSY};
  expect_fault(CameraState::Failing, "in use by another program");
  Frame frame;
  recover(frame);
}

// What the device can't do.

TEST_F(V4l2CameraTest, AFormatThatTheDeviceLacksIsRefusedWithWhatItHas) {
  device_.modes = {{V4L2_PIX_FMT_YUYV, 640, 480, {30, 15}},
                   {V4L2_PIX_FMT_MJPEG, 1280, 720, {30}},
                   {V4L2_PIX_FMT_H264, 1280, 720, {30}}};
  config_.width_px = 640;
  config_.height_px = 480;
  config_.rate_hz = 30;
  config_.format = "NV12";
  EXPECT_THAT(
      refusal(),
      AllOf(
          HasSubstr("/dev/video0: source.format \"NV12\" at 640x480 px and 30 Hz"),
          HasSubstr("YUYV 640x480 at 30, 15 Hz; MJPEG 1280x720 at 30 Hz; H264, which Facet does not read")));
  config_.format = "YUYV";
  open();
  config_.width_px = 1280;
  config_.height_px = 720;
  EXPECT_THAT(refusal(), HasSubstr("YUYV 640x480 at 30, 15 Hz"));
  config_.format = "auto";
  open();
  config_.rate_hz = 60;
  EXPECT_THAT(refusal(), HasSubstr("at 1280x720 px and 60 Hz is not among"));
  config_.rate_hz = 29.97;
  open();
}

TEST_F(V4l2CameraTest, WhatADeviceOffersIsToldInAFewWords) {
  // As vivid does it, which has 96 formats of six sizes and twelve rates.
  for (const std::uint32_t fourcc :
       {V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_UYVY, V4L2_PIX_FMT_NV12, V4L2_PIX_FMT_NV16, V4L2_PIX_FMT_NV21,
        V4L2_PIX_FMT_Y12, V4L2_PIX_FMT_Y16_BE, V4L2_PIX_FMT_RGB24, V4L2_PIX_FMT_BGR24, V4L2_PIX_FMT_GREY}) {
    device_.modes.push_back({fourcc, 640, 480, {15, 30}});
    device_.modes.push_back({fourcc, 320, 240, {15, 30}});
    device_.modes.push_back({fourcc, 1280, 720, {fourcc == V4L2_PIX_FMT_GREY ? 30 : 15}});
  }
  device_.modes.erase(device_.modes.begin());
  config_.width_px = 8;
  EXPECT_THAT(refusal(),
              HasSubstr("YUYV, NV12 640x480, 320x240 at 15, 30 Hz; 1280x720 at 15 Hz; "
                        "GREY 640x480, 320x240 at 15, 30 Hz; 1280x720 at 30 Hz; "
                        "UYVY, NV16, NV21, Y12, Y16-BE, RGB3 and 1 more, which Facet does not read"));
  device_.modes.clear();
  device_.modes.push_back({V4L2_PIX_FMT_UYVY, 640, 480, {15, 30}});
  EXPECT_THAT(refusal(), HasSubstr("what the device has: UYVY, which Facet does not read"));
}

TEST_F(V4l2CameraTest, ADeviceWithoutFormatsIsAwaited) {
  const auto modes = std::exchange(device_.modes, {});
  started();
  expect_fault(CameraState::Failing, "offers no pixel format yet");
  device_.modes = modes;
  Frame frame;
  recover(frame);
}

TEST_F(V4l2CameraTest, AutoTakesTheFirstFormatThatHasSizeAndRate) {
  device_.modes = {
      {V4L2_PIX_FMT_GREY, 4, 2, {10}}, {V4L2_PIX_FMT_YUYV, 4, 2, {5}}, {V4L2_PIX_FMT_NV12, 4, 2, {10}}};
  std::size_t bytes = 0;
  device_.on_fill = [&](test::FakeV4l2::Filled& filled) { bytes = filled.bytes.size(); };
  started();
  next();
  EXPECT_EQ(bytes, 12U) << "NV12: YUYV has not the rate, GREY comes later";
}

TEST_F(V4l2CameraTest, RangesOfSizesAndRates) {
  device_.modes = {{V4L2_PIX_FMT_GREY, 2, 2, {1, 60}}, {V4L2_PIX_FMT_GREY, 1920, 1080, {1, 60}}};
  device_.sizes_in_a_range = true;
  open();
  config_.width_px = 3840;
  EXPECT_THAT(refusal(), HasSubstr("GREY 2x2 to 1920x1080 at 1 to 60 Hz"));
}

TEST_F(V4l2CameraTest, ASilentlyChangedFormatIsAFaultThatNamesBoth) {
  device_.tells_sizes = false;
  config_.width_px = 8;
  started();
  expect_fault(CameraState::Failing, "gives GREY 4x2 px instead of GREY 8x2 px");
}

TEST_F(V4l2CameraTest, ASilentlyChangedRateIsAFaultThatNamesBoth) {
  device_.tells_sizes = false;
  config_.rate_hz = 25;
  started();
  expect_fault(CameraState::Failing, "gives 30 Hz instead of source.rate_hz = 25");
}

TEST_F(V4l2CameraTest, HalfPicturesAreRefused) {
  device_.field = V4L2_FIELD_INTERLACED;
  started();
  expect_fault(CameraState::Failing, "interlaced");
}

TEST_F(V4l2CameraTest, ADeviceThatIsNoCameraIsRefused) {
  device_.capabilities = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
  EXPECT_THAT(refusal(), HasSubstr("does not stream pictures"));
  device_.capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
  device_.errors[VIDIOC_QUERYCAP] = {ENOTTY};
  EXPECT_THAT(refusal(), HasSubstr("no video device"));
}

TEST_F(V4l2CameraTest, ALoopbackDeviceIsAwaitedUntilSomethingWritesIntoIt) {
  for (const std::uint32_t direction :
       {std::uint32_t{V4L2_CAP_VIDEO_OUTPUT}, std::uint32_t{0}}) {  // before the first writer, after it
    device_.capabilities = direction | V4L2_CAP_STREAMING | V4L2_CAP_READWRITE | V4L2_CAP_EXT_PIX_FORMAT;
    open();
    EXPECT_EQ(status().state, CameraState::Failing);
    camera_->start();
    expect_fault(CameraState::Failing, "nothing writes into it");
    device_.capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
    Frame frame;
    recover(frame);
  }
}

TEST_F(V4l2CameraTest, AnotherCameraInItsPlaceThatCannotDoItIsAFault) {
  started();
  next();
  device_.unplug();
  expect_fault(CameraState::Absent, "no such device");
  device_.modes = {{V4L2_PIX_FMT_YUYV, 640, 480, {30}}};
  device_.present = true;
  Frame frame;
  EXPECT_EQ(camera_->next(frame, 1s), CaptureOutcome::Timeout);
  expect_fault(CameraState::Failing, "YUYV 640x480 at 30 Hz");
}

// Controls.

class V4l2ControlTest : public V4l2CameraTest {
 protected:
  V4l2ControlTest() {
    device_.controls = {
        {V4L2_CID_EXPOSURE_AUTO, {0, 3, 1, -1, {V4L2_EXPOSURE_MANUAL, V4L2_EXPOSURE_APERTURE_PRIORITY}}},
        {V4L2_CID_EXPOSURE_AUTO_PRIORITY, {0, 1, 1, 1, {}}},
        {V4L2_CID_EXPOSURE_ABSOLUTE, {1, 5000, 1, 157, {}}},
        {V4L2_CID_AUTOGAIN, {0, 1, 1, -1, {}}},
        {V4L2_CID_GAIN, {0, 255, 1, 64, {}}},
        {V4L2_CID_AUTO_WHITE_BALANCE, {0, 1, 1, -1, {}}},
        {V4L2_CID_WHITE_BALANCE_TEMPERATURE, {2800, 6500, 10, 4000, {}}},
    };
  }
  std::int64_t value(std::uint32_t id) { return device_.controls.at(id).value; }
};

TEST_F(V4l2ControlTest, AreLeftToTheDeviceUnlessGiven) {
  started();
  next();
  EXPECT_EQ(value(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_APERTURE_PRIORITY);
  EXPECT_EQ(value(V4L2_CID_EXPOSURE_AUTO_PRIORITY), 0) << "the rate counts more than the exposure";
  EXPECT_EQ(value(V4L2_CID_AUTOGAIN), 1);
  EXPECT_EQ(value(V4L2_CID_AUTO_WHITE_BALANCE), 1);
  EXPECT_EQ(value(V4L2_CID_EXPOSURE_ABSOLUTE), 157);
}

TEST_F(V4l2ControlTest, AreSetWhereGiven) {
  config_.exposure_us = 5000;
  config_.gain = 17;
  config_.white_balance_k = 5000;
  started();
  next();
  EXPECT_EQ(value(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
  EXPECT_EQ(value(V4L2_CID_EXPOSURE_ABSOLUTE), 50) << "units of 100 us";
  EXPECT_EQ(value(V4L2_CID_EXPOSURE_AUTO_PRIORITY), 1) << "of no matter, left alone";
  EXPECT_EQ(value(V4L2_CID_AUTOGAIN), 0);
  EXPECT_EQ(value(V4L2_CID_GAIN), 17);
  EXPECT_EQ(value(V4L2_CID_AUTO_WHITE_BALANCE), 0);
  EXPECT_EQ(value(V4L2_CID_WHITE_BALANCE_TEMPERATURE), 5000);
}

TEST_F(V4l2ControlTest, ValuesThatTheDeviceDoesNotTakeAreRefusedWithTheRange) {
  config_.exposure_us = 600'000;
  EXPECT_THAT(refusal(),
              HasSubstr("source.exposure_us = 600000: the device takes 100 to 500000 in steps of 100"));
  config_.exposure_us = 50;
  EXPECT_THAT(refusal(), HasSubstr("source.exposure_us = 50: the device takes 100"));
  config_.exposure_us.reset();
  config_.gain = 300;
  EXPECT_THAT(refusal(), HasSubstr("source.gain = 300: the device takes 0 to 255 in steps of 1"));
}

TEST_F(V4l2ControlTest, ControlsThatTheDeviceLacksAreRefusedWithThoseItHas) {
  device_.controls.erase(V4L2_CID_EXPOSURE_ABSOLUTE);
  config_.exposure_us = 5000;
  EXPECT_THAT(refusal(),
              HasSubstr("source.exposure_us can't be set; the device lets set: gain 0 to 255 in steps "
                        "of 1, white_balance_k 2800 to 6500"));
  device_.controls.clear();
  EXPECT_THAT(refusal(), HasSubstr("none of exposure, gain and white balance"));
}

TEST_F(V4l2ControlTest, AControlThatTheDriverRefusesIsAFault) {
  config_.gain = 17;
  device_.controls.erase(V4L2_CID_AUTOGAIN);
  device_.controls.erase(V4L2_CID_EXPOSURE_AUTO);
  device_.controls.erase(V4L2_CID_EXPOSURE_AUTO_PRIORITY);
  device_.controls.erase(V4L2_CID_AUTO_WHITE_BALANCE);
  device_.errors[VIDIOC_S_CTRL] = {EINVAL};
  started();
  expect_fault(CameraState::Failing, "source.gain = 17: the device does not take it");
  Frame frame;
  recover(frame);
  EXPECT_EQ(value(V4L2_CID_GAIN), 17);
}

// Controls by their names.

constexpr std::uint32_t kTriggerMode = V4L2_CID_CAMERA_CLASS_BASE + 0x1000;
constexpr std::uint32_t kTriggerSource = kTriggerMode + 1;
constexpr std::uint32_t kTriggerDelay = kTriggerMode + 2;
constexpr std::uint32_t kLines = kTriggerMode + 3;
constexpr std::uint32_t kLinkFrequency = kTriggerMode + 4;
constexpr std::uint32_t kSerialNumber = kTriggerMode + 5;
constexpr std::uint32_t kReset = kTriggerMode + 6;

/// A camera of an industrial kind.
class V4l2NamedControlTest : public V4l2CameraTest {
 protected:
  V4l2NamedControlTest() {
    device_.controls = {
        {V4L2_CID_CAMERA_CLASS, {0, 0, 0, 0, {}, "Camera Controls", V4L2_CTRL_TYPE_CTRL_CLASS}},
        {V4L2_CID_BRIGHTNESS, {-64, 64, 4, 0, {}, "Brightness"}},
        {V4L2_CID_AUTO_WHITE_BALANCE, {0, 1, 1, 1, {}, "White Balance, Automatic", V4L2_CTRL_TYPE_BOOLEAN}},
        {kTriggerMode, {0, 1, 1, 0, {}, "Trigger Mode", V4L2_CTRL_TYPE_BOOLEAN}},
        {kTriggerSource,
         {0, 3, 1, 0, {0, 1, 3}, "Trigger Source", 0, {{0, "Software"}, {1, "Line 1"}, {3, "Line 3"}}}},
        {kTriggerDelay, {0, 10'000'000'000, 1, 0, {}, "Trigger Delay (ns)", V4L2_CTRL_TYPE_INTEGER64}},
        {kLines, {0, 0xF000000F, 0, 0, {}, "Line Inverter", V4L2_CTRL_TYPE_BITMASK}},
        {kLinkFrequency,
         {0, 1, 1, 0, {0, 1}, "Link Frequency", 0, {}, {{0, 400'000'000}, {1, 5'000'000'000}}}},
        {kSerialNumber,
         {0, 9, 1, 5, {}, "Serial Number", V4L2_CTRL_TYPE_INTEGER, {}, {}, V4L2_CTRL_FLAG_READ_ONLY}},
        {kReset, {0, 0, 0, 0, {}, "Reset", V4L2_CTRL_TYPE_BUTTON}},
    };
  }
  std::int64_t value(std::uint32_t id) { return device_.controls.at(id).value; }
  std::string refusal_of(const ControlSetting& setting) {
    config_.controls = {setting};
    return refusal();
  }
};

constexpr const char* kAllNamed =
    "brightness -64 to 64 in steps of 4; white_balance_automatic true or false; trigger_mode true or false; "
    "trigger_source one of \"Software\", \"Line 1\", \"Line 3\"; trigger_delay_ns 0 to 10000000000; "
    "line_inverter bits of 0xF000000F; link_frequency one of 400000000, 5000000000";

TEST_F(V4l2NamedControlTest, NamesAreSpelledAsV4l2sToolsDo) {
  EXPECT_EQ(control_key("Trigger Mode"), "trigger_mode");
  EXPECT_EQ(control_key("White Balance, Automatic"), "white_balance_automatic");
  EXPECT_EQ(control_key("  Gain (dB) "), "gain_db");
  EXPECT_EQ(control_key("trigger_mode"), "trigger_mode");
  EXPECT_EQ(control_key("-- \xC3\xA4"), "");
}

TEST_F(V4l2NamedControlTest, AreSetInTheirOrder) {
  config_.controls = {{"Trigger Source", "Line 3"},
                      {"trigger_mode", true},
                      {"TRIGGER DELAY NS", std::int64_t{5'000'000'123}},
                      {"line inverter", std::int64_t{0xF0000001}},
                      {"Link Frequency", std::int64_t{5'000'000'000}},
                      {"white_balance_automatic", false},
                      {"Brightness", std::int64_t{-60}}};
  std::vector<std::uint32_t> order;
  device_.on_control = [&](std::uint32_t id) { order.push_back(id); };
  open();
  EXPECT_TRUE(order.empty()) << "nothing is set before the camera is started";
  camera_->start();
  next();
  EXPECT_EQ(value(kTriggerSource), 3);
  EXPECT_EQ(value(kTriggerMode), 1);
  EXPECT_EQ(value(kTriggerDelay), 5'000'000'123);
  EXPECT_EQ(static_cast<std::uint32_t>(value(kLines)), 0xF0000001U);
  EXPECT_EQ(value(kLinkFrequency), 1);
  EXPECT_EQ(value(V4L2_CID_BRIGHTNESS), -60);
  EXPECT_EQ(value(V4L2_CID_AUTO_WHITE_BALANCE), 0) << "what is named counts more than what is left alone";
  const std::vector<std::uint32_t> wanted = {
      V4L2_CID_AUTO_WHITE_BALANCE, kTriggerSource,     kTriggerMode, kTriggerDelay, kLines, kLinkFrequency,
      V4L2_CID_AUTO_WHITE_BALANCE, V4L2_CID_BRIGHTNESS};
  EXPECT_EQ(order, wanted);
  // And again after a fault.
  device_.controls.at(kTriggerMode).value = 0;
  device_.break_stream();
  expect_fault(CameraState::Failing, "Input/output error");
  Frame frame;
  recover(frame);
  EXPECT_EQ(value(kTriggerMode), 1);
}

TEST_F(V4l2NamedControlTest, WhatTheDeviceLacksIsRefusedWithWhatItHas) {
  EXPECT_EQ(
      refusal_of({"Trigger Modus", true}),
      std::string("/dev/video0: source.controls.trigger_modus = true: the device has no such control; it "
                  "has: ") +
          kAllNamed);
  for (const char* name : {"Camera Controls", "Reset", "Serial Number", ""}) {
    EXPECT_THAT(refusal_of({name, std::int64_t{1}}), HasSubstr("the device has no such control")) << name;
  }
  device_.controls.clear();
  EXPECT_THAT(refusal_of({"Trigger Mode", true}), HasSubstr("has no such control; it has: none"));
}

TEST_F(V4l2NamedControlTest, ValuesOfTheWrongKindOrOutOfRangeAreRefusedWithWhatItTakes) {
  const auto number = [](const char* name, std::int64_t value) { return ControlSetting{name, value}; };
  for (const ControlSetting& setting :
       {number("brightness", -65), number("brightness", 65), number("brightness", 62),
        number("brightness", INT64_MIN), number("brightness", INT64_MAX), ControlSetting{"brightness", true},
        ControlSetting{"brightness", "64"}}) {
    EXPECT_THAT(refusal_of(setting), HasSubstr(": the device takes -64 to 64 in steps of 4"));
  }
  EXPECT_THAT(refusal_of(number("trigger_mode", 1)), HasSubstr("takes true or false"));
  EXPECT_THAT(refusal_of({"trigger_mode", "on"}), HasSubstr("takes true or false"));
  EXPECT_THAT(
      refusal_of({"trigger_source", "Line 2"}),
      HasSubstr("source.controls.trigger_source = \"Line 2\": the device takes one of \"Software\", "));
  EXPECT_THAT(refusal_of(number("trigger_source", 1)), HasSubstr("takes one of \"Software\", "));
  EXPECT_THAT(refusal_of(number("line_inverter", 16)), HasSubstr("takes bits of 0xF000000F"));
  EXPECT_THAT(refusal_of(number("line_inverter", -1)), HasSubstr("takes bits of 0xF000000F"));
  EXPECT_THAT(refusal_of(number("link_frequency", 1)), HasSubstr("takes one of 400000000, 5000000000"));
  EXPECT_THAT(refusal_of(number("trigger_delay_ns", -1)), HasSubstr("takes 0 to 10000000000"));
}

TEST_F(V4l2NamedControlTest, TwoOfOneNameAreNotGuessedAt) {
  device_.controls.at(kTriggerDelay).name = "Trigger-Mode";
  EXPECT_THAT(refusal_of({"trigger_mode", true}), HasSubstr("several controls of this name"));
}

TEST_F(V4l2NamedControlTest, OneThatAnotherLetsBeSet) {
  device_.controls.at(kTriggerDelay).flags = V4L2_CTRL_FLAG_INACTIVE;
  device_.on_control = [&](std::uint32_t id) {
    device_.controls.at(kTriggerDelay).flags =
        id == kTriggerMode ? 0 : device_.controls.at(kTriggerDelay).flags;
  };
  config_.controls = {{"Trigger Delay (ns)", std::int64_t{7}}, {"Trigger Mode", true}};
  started();
  expect_fault(CameraState::Failing,
               "source.controls.trigger_delay_ns = 7: the device does not take it now; another control may");
  camera_.reset();
  std::swap(config_.controls[0], config_.controls[1]);
  started();
  next();
  EXPECT_EQ(value(kTriggerDelay), 7);
}

TEST_F(V4l2NamedControlTest, ValuesThatTheDriverChangesAreTold) {
  device_.on_control = [&](std::uint32_t id) {
    device_.controls.at(kTriggerDelay).value = id == kTriggerDelay ? 8 : 0;
  };
  config_.controls = {{"Trigger Delay (ns)", std::int64_t{7}}};
  started();
  expect_fault(CameraState::Failing, "source.controls.trigger_delay_ns = 7: the device made it 8");
}

TEST_F(V4l2NamedControlTest, ADriverWhoseListHasNoEnd) {
  device_.controls = {{kTriggerMode, {0, 2'000'000'000, 1, 0, {0}, "Endless", 0, {{0, "Zero"}}}}};
  EXPECT_THAT(refusal_of({"endless", "One"}), HasSubstr("takes one of \"Zero\""));
}

// For people.

TEST_F(V4l2CameraTest, ListsDevices) {
  const test::TemporaryFolder folder;
  const auto touch = [&](const char* name) { std::ofstream(folder.path() / name).put('x'); };
  touch("video1");
  touch("video0");
  touch("vcs");
  device_.path = (folder.path() / "video1").string();
  device_.controls = {{V4L2_CID_CAMERA_CLASS_BASE, {0, 1, 1, 0, {}, "Trigger Mode", V4L2_CTRL_TYPE_BOOLEAN}}};
  const auto listed = list_v4l2_devices(folder.path(), device_);
  ASSERT_EQ(listed.size(), 1U) << "video0 is no device, vcs has another name";
  EXPECT_EQ(listed[0].path, device_.path);
  EXPECT_EQ(listed[0].card, "Fake Camera");
  EXPECT_EQ(listed[0].modes, "GREY 4x2 at 10, 30 Hz");
  EXPECT_EQ(listed[0].controls, "trigger_mode true or false");
  device_.open_error = EACCES;
  EXPECT_THAT(list_v4l2_devices(folder.path(), device_).at(0).modes, HasSubstr("may not be opened"));
  EXPECT_TRUE(list_v4l2_devices(folder.path() / "missing", device_).empty());
}

/// The system's own kernel interface, on this machine's first camera where there is one.
TEST(V4l2RealDevice, Delivers) {
  std::unique_ptr<Camera> camera;
  std::string refusals;
  for (const auto& device : list_v4l2_devices()) {
    for (const auto& [width, height] : {std::pair{640, 480}, std::pair{320, 180}, std::pair{1280, 720}}) {
      LiveConfig config;
      config.device = device.path;
      config.width_px = width;
      config.height_px = height;
      try {
        auto opened = open_v4l2_camera(config);
        if (camera == nullptr && opened->status().state == CameraState::Idle) {
          camera = std::move(opened);
        } else {
          refusals += opened->status().reason + "; ";
        }
      } catch (const Error& error) {
        refusals += std::string(error.what()) + "; ";
      }
    }
  }
  if (camera == nullptr) {
    GTEST_SKIP() << "no video device of 640x480, 320x180 or 1280x720 px at 30 Hz on this machine "
                 << refusals;
  }
  camera->start();
  Frame first;
  ASSERT_EQ(camera->next(first, 10s), CaptureOutcome::Delivered) << camera->last_error();
  Frame second;
  ASSERT_EQ(camera->next(second, 10s), CaptureOutcome::Delivered) << camera->last_error();
  EXPECT_GT(second.timestamp_ns, first.timestamp_ns);
  EXPECT_GT(second.sequence, first.sequence);
}

TEST(V4l2RealDevice, WithoutADeviceItIsAbsent) {
  LiveConfig config;
  config.device = "/dev/there-is-no-such-video-device";
  const auto camera = open_v4l2_camera(config);
  camera->start();
  Frame frame;
  EXPECT_EQ(camera->next(frame, 1ms), CaptureOutcome::Timeout);
  EXPECT_EQ(camera->status().state, CameraState::Absent);
  EXPECT_THAT(camera->last_error(), HasSubstr("no such device"));
}

TEST(V4l2RealDevice, WhatIsNoVideoDeviceIsRefused) {
  LiveConfig config;
  config.device = "/dev/null";
  EXPECT_THROW(open_v4l2_camera(config), Error);
}

}  // namespace
}  // namespace facet::camera
