// The pipeline with its real stages on sequences put together from a real clip: who comes, goes, and is cut.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "film.hpp"

namespace facet::pipeline {
namespace {

using mesh::TrackingState;

using Faces = Film;

TEST_F(Faces, AFaceThatLeavesIsLostAndKnownWhenItComesBackElsewhere) {
  const auto person = read("cap12_edit", 24);
  constexpr int kLeaves = 10;
  constexpr int kReturns = 16;
  film(2 * kClipWidth_px, 24, [&](render::Picture& onto, int f) {
    if (f < kLeaves || f >= kReturns) {
      render::paste(onto, person[static_cast<std::size_t>(f)], f < kLeaves ? 0 : kClipWidth_px, 0);
    }
  });
  const Frames frames = run();
  ASSERT_EQ(frames.size(), 24U);
  for (const auto& frame : frames) {
    expect_plausible(*frame);
    const bool there = frame->sequence < kLeaves || frame->sequence >= kReturns;
    EXPECT_EQ(frame->landmarks_px.empty(), !there) << frame->sequence;
    if (has_mesh(*frame)) {
      EXPECT_NEAR(seen_at_px(*frame), kFaceMiddle_px + (frame->sequence < kLeaves ? 0 : kClipWidth_px),
                  kFaceHalf_px);
    }
  }
  EXPECT_EQ(frames[kLeaves - 1]->state, TrackingState::Tracking);
  EXPECT_EQ(frames[kReturns - 1]->state, TrackingState::Lost);
  EXPECT_EQ(frames.back()->state, TrackingState::Tracking);
  EXPECT_EQ(status_.subjects, 1U) << "the same person";
}

TEST_F(Faces, ASecondFaceDoesNotTakeOver) {
  const auto person = read("cap12_edit", 24);
  const auto other = read("cap13_edit2", 24);
  constexpr int kOtherComes = 8;
  film(2 * kClipWidth_px, 24, [&](render::Picture& onto, int f) {
    render::paste(onto, person[static_cast<std::size_t>(f)], kClipWidth_px, 0);
    if (f >= kOtherComes) {
      render::paste(onto, other[static_cast<std::size_t>(f)], 0, 0);
    }
  });
  const Frames frames = run();
  ASSERT_EQ(frames.size(), 24U);
  for (const auto& frame : frames) {
    expect_plausible(*frame);
    EXPECT_EQ(frame->state, TrackingState::Tracking) << frame->sequence;
    EXPECT_NEAR(seen_at_px(*frame), kClipWidth_px + kFaceMiddle_px, kFaceHalf_px) << frame->sequence;
  }
  EXPECT_EQ(status_.subjects, 1U);
}

TEST_F(Faces, HalfAFaceGivesASaneMeshOrNone) {
  const auto person = read("cap12_edit", 40);
  // The face goes out at the left until it is half gone, stays so, and comes back.
  const auto shift_px = [](int f) { return std::clamp(20 * std::min(f - 8, 34 - f), 0, kFaceMiddle_px); };
  film(kClipWidth_px, 40, [&](render::Picture& onto, int f) {
    render::paste(onto, person[static_cast<std::size_t>(f)], -shift_px(f), 0);
  });
  const Frames frames = run();
  ASSERT_EQ(frames.size(), 40U);
  for (const auto& frame : frames) {
    expect_plausible(*frame);
    if (has_mesh(*frame)) {
      const auto shift = static_cast<float>(shift_px(static_cast<int>(frame->sequence)));
      EXPECT_NEAR(seen_at_px(*frame), kFaceMiddle_px - shift, kFaceHalf_px) << frame->sequence;
    }
  }
  EXPECT_EQ(frames.front()->state, TrackingState::Tracking);
  EXPECT_EQ(frames.back()->state, TrackingState::Tracking);
  EXPECT_EQ(status_.subjects, 1U);
}

TEST_F(Faces, WhoStandsOutsideTheRangeSaysNothingOfThePersonInIt) {
  constexpr int kOtherComes = 8;
  const auto person = read("cap12_edit", kOtherComes);
  const auto other = read("cap13_edit2", 24);
  config_.gpu_device = kNoDevice;
  const auto frames_of = [&](const char* file, int frame_count) {
    config_.source.path = folder_.path() / file;
    film(kClipWidth_px, frame_count, [&](render::Picture& onto, int f) {
      render::paste(onto,
                    f < kOtherComes ? person[static_cast<std::size_t>(f)]
                                    : other[static_cast<std::size_t>(f - kOtherComes)],
                    0, 0);
    });
    return run();
  };
  const Frames alone = frames_of("alone.mkv", kOtherComes);
  config_.frames.end = kOtherComes;
  const Frames before_other = frames_of("both.mkv", kOtherComes + 24);
  ASSERT_EQ(alone.size(), std::size_t{kOtherComes});
  ASSERT_EQ(before_other.size(), alone.size());
  for (std::size_t f = 0; f < alone.size(); ++f) {
    ASSERT_TRUE(has_mesh(*alone[f])) << f;
    ASSERT_TRUE(has_mesh(*before_other[f])) << f;
    EXPECT_EQ(before_other[f]->control_vertices_mm, alone[f]->control_vertices_mm) << f;
  }
}

TEST_F(Faces, AStopWhileLookingAheadEstimatesNobody) {
  constexpr int kSeen = 10;
  const auto person = read("cap12_edit", 2 * kSeen);
  film(kClipWidth_px, 2 * kSeen,
       [&](render::Picture& onto, int f) { render::paste(onto, person[static_cast<std::size_t>(f)], 0, 0); });
  config_.gpu_device = kNoDevice;
  const auto state_after = [&](int looks) {
    const ShadingParts stages = open_shading(config_);
    stages.coarse->prepare([&] { return looks-- > 0; });
    stages.pictures->start();
    FrameSet first;
    EXPECT_EQ(stages.pictures->next(first, std::chrono::seconds(10)), CaptureOutcome::Delivered);
    return stages.coarse->process(first.frames).state;
  };
  config_.tracker.acquisition_frames = 1000;
  EXPECT_EQ(state_after(kSeen), TrackingState::Acquiring);
  EXPECT_EQ(state_after(1000), TrackingState::Tracking) << "unless stopped, few frames do";
}

}  // namespace
}  // namespace facet::pipeline
