#include "track/tracker.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <optional>
#include <vector>

#include "allocation_counter.hpp"
#include "camera/factory.hpp"
#include "face/person_model.hpp"
#include "facet/error.hpp"
#include "support/frames.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"

namespace facet::track {
namespace {

using mesh::TrackingState;

/// The tracker with the real nets and the built model, on a real clip.
class TrackerTest : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(test::landmark_nets())) {
      GTEST_SKIP() << test::landmark_nets() << " is missing: run packaging/fetch-assets";
    }
    if (!std::filesystem::exists(test::default_model())) {
      GTEST_SKIP() << test::default_model() << " is missing: run `facet model build`";
    }
    model = std::make_unique<face::FaceModel>(face::FaceModel::load(test::default_model()));
    if (model->landmarks.empty()) {
      GTEST_SKIP() << "the model has no landmark map";
    }
    tracker = std::make_unique<Tracker>(
        *model, TrackerConfig{.landmark_nets = test::landmark_nets(), .intrinsics = {}});
  }

  static Frame grey(int width, int height) {
    return test::make_frame(width, height, [](int, int) { return cv::Vec3b(110, 110, 110); });
  }

  std::unique_ptr<face::FaceModel> model;
  std::unique_ptr<Tracker> tracker;
};

TEST_F(TrackerTest, FollowsARealFaceCloselyFromTheFirstFrameOnOnceAdopted) {
  const auto clip = test::assets() / "video" / "cap13_edit2.mp4";
  if (!std::filesystem::exists(clip)) {
    GTEST_SKIP() << clip << " is missing: run packaging/fetch-assets";
  }
  Frame frame;
  const auto open = [&] {
    auto camera = camera::open_camera({.kind = "file", .path = clip});
    camera->start();
    return camera;
  };
  auto camera = open();
  int frames = 0;
  while (!tracker->person() && ++frames <= 150) {
    ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered);
    const TrackResult& result = tracker->process(frame);
    EXPECT_TRUE(result.state == TrackingState::Acquiring || result.state == TrackingState::Tracking);
    EXPECT_TRUE(result.has_mesh) << "a provisional mesh from the first frame on";
  }
  ASSERT_TRUE(tracker->person().has_value()) << "not acquired within 150 frames";

  Tracker second(*model, {.landmark_nets = test::landmark_nets(), .intrinsics = {}});
  second.adopt(*tracker->person(), frame.width_px, frame.height_px);
  Tracker slow(*model, {.landmark_nets = test::landmark_nets(), .intrinsics = {}});
  slow.adopt(*tracker->person(), frame.width_px, frame.height_px);
  camera = open();
  for (int f = 0; f < 60; ++f) {
    ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered);
    const TrackResult& result = second.process(frame);
    ASSERT_EQ(result.state, TrackingState::Tracking) << "frame " << f;
    EXPECT_TRUE(result.vertices_mm.allFinite());
    // A head: no vertex is further than this from its middle.
    EXPECT_LT(result.vertices_mm.cwiseAbs().maxCoeff(), 300.0F);
    EXPECT_LT(result.reprojection_px, 0.04F * result.interocular_px) << "frame " << f;
    EXPECT_EQ(result.landmarks_px.size(), 468U);
    EXPECT_EQ(result.subject, 1U);
    EXPECT_GE(*std::min_element(result.expression.begin(), result.expression.end()), 0.0F);
    EXPECT_LE(*std::max_element(result.expression.begin(), result.expression.end()), 1.0F);
    EXPECT_GE(*std::min_element(result.values.begin(), result.values.end()), 0.0F);
    EXPECT_LE(*std::max_element(result.values.begin(), result.values.end()), 1.0F);
    EXPECT_NE(result.values, result.expression) << "they are read";
    // A source that is worked off slowly gives the same result: only its own clock counts.
    Frame late = frame;
    late.timestamp_ns = static_cast<std::int64_t>(f) * 2'000'000'000;
    EXPECT_EQ(slow.process(late).vertices_mm, result.vertices_mm) << "frame " << f;
  }

  // The face goes and comes back.
  second.process(grey(frame.width_px, frame.height_px));
  const TrackResult& gone = second.process(grey(frame.width_px, frame.height_px));
  EXPECT_EQ(gone.state, TrackingState::Lost);
  EXPECT_FALSE(gone.has_mesh);
  TrackingState back = TrackingState::Lost;
  for (int f = 0; f < 30 && back != TrackingState::Tracking; ++f) {
    ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered);
    back = second.process(frame).state;
  }
  EXPECT_EQ(back, TrackingState::Tracking);
}

TEST_F(TrackerTest, ALiveHeadOfAKnownShapeIsFoundAndNotGuessedAnew) {
  const auto clip = test::assets() / "video" / "cap13_edit2.mp4";
  if (!std::filesystem::exists(clip)) {
    GTEST_SKIP() << clip << " is missing: run packaging/fetch-assets";
  }
  auto camera = camera::open_camera({.kind = "file", .path = clip});
  camera->start();
  std::vector<Frame> frames(60);
  for (Frame& frame : frames) {
    ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered);
    tracker->process(frame);
  }
  ASSERT_TRUE(tracker->settle_subject());
  const std::optional<Person> guess = tracker->person();
  ASSERT_TRUE(guess);
  const std::vector<float> identity(guess->shape.identity.begin(), guess->shape.identity.end());
  const face::FaceModel his = face::person_model(
      *model, identity, model->contract_identity(identity).neutral_mm.cast<double>(), "him");
  const auto first_tracked = [&](const face::FaceModel& whose, bool live) {
    Tracker fresh(whose, {.landmark_nets = test::landmark_nets(), .intrinsics = {}, .live = live});
    const auto found = std::find_if(frames.begin(), frames.end(), [&](const Frame& frame) {
      return fresh.process(frame).state == TrackingState::Tracking;
    });
    return found - frames.begin();
  };
  const auto known = first_tracked(his, true);
  EXPECT_LE(known, 20);
  EXPECT_GT(first_tracked(his, false), 2 * known) << "a recording has the time to look longer";
  EXPECT_GT(first_tracked(*model, true), 2 * known) << "so has a guess";
}

TEST_F(TrackerTest, AFollowedFaceCostsNoAllocation) {
  const auto clip = test::assets() / "video" / "cap13_edit2.mp4";
  if (!std::filesystem::exists(clip) || !test::allocations_are_counted()) {
    GTEST_SKIP() << clip
                 << " is missing (packaging/fetch-assets), or the sanitizers bring their own allocator";
  }
  auto camera = camera::open_camera({.kind = "file", .path = clip});
  camera->start();
  std::vector<Frame> frames(120);
  for (Frame& frame : frames) {
    ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered);
    tracker->process(frame);
  }
  ASSERT_TRUE(tracker->person().has_value());
  // Nets, filters, fit, and the detector's checks beside them.
  const std::size_t before = test::allocation_count();
  ASSERT_GT(before, 0U) << "the counter does not count";
  for (std::size_t f = frames.size() - 30; f < frames.size(); ++f) {
    ASSERT_EQ(tracker->process(frames[f]).state, TrackingState::Tracking) << f;
  }
  EXPECT_EQ(test::allocation_count() - before, 0U);
}

TEST_F(TrackerTest, FramesWithoutAFaceAreSearchedNotFeared) {
  EXPECT_EQ(tracker->process(Frame{}).state, TrackingState::Searching);
  for (const auto& [width, height] :
       {std::pair(1, 1), std::pair(16, 16), std::pair(127, 13), std::pair(640, 480)}) {
    const TrackResult& result = tracker->process(grey(width, height));
    EXPECT_EQ(result.state, TrackingState::Searching);
    EXPECT_FALSE(result.has_mesh);
    EXPECT_TRUE(result.landmarks_px.empty());
  }
}

TEST(TrackerStart, ErrorsSayWhatToDo) {
  const face::FaceModel model = test::synthetic_model();
  try {
    Tracker tracker(model, {.landmark_nets = "no/such.data", .intrinsics = {}});
    FAIL() << "missing nets were accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    EXPECT_NE(std::string(error.what()).find("no/such.data"), std::string::npos) << error.what();
  }
  if (!std::filesystem::exists(test::landmark_nets())) {
    GTEST_SKIP() << test::landmark_nets() << " is missing: run packaging/fetch-assets";
  }
  face::FaceModel without_map = model;
  without_map.landmarks.clear();
  try {
    Tracker tracker(without_map, {.landmark_nets = test::landmark_nets(), .intrinsics = {}});
    FAIL() << "a model without landmarks was accepted";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("facet model build"), std::string::npos) << error.what();
  }
  Tracker tracker(model, {.landmark_nets = test::landmark_nets(), .intrinsics = {}});
  EXPECT_FALSE(tracker.person().has_value());
  EXPECT_THROW(tracker.adopt(Person{}, 640, 480), Error);
}

}  // namespace
}  // namespace facet::track
