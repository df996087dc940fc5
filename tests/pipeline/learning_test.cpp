// A head that turns is learned: from its recording before the first frame, live beside the frames.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "pipeline/learning_tracker.hpp"
#include "pipeline/shading_parts.hpp"
#include "simulation/actor_sequence.hpp"
#include "simulation/video_writer.hpp"
#include "support/paths.hpp"

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;
using ::testing::HasSubstr;

/// An actor who turns calmly, and another person.
class ATurningHead : public ::testing::Test {
 protected:
  static constexpr int kFramesPerSecond = 6;
  static constexpr std::int64_t kStep_ns = 1'000'000'000 / kFramesPerSecond;

  static void SetUpTestSuite() {
#ifndef FACET_SANITIZED
    if (!std::filesystem::exists(test::default_model())) {
      return;
    }
    const auto model = face::FaceModel::load(test::default_model());
    simulation::ActorSequenceConfig turn;
    turn.seed = 352;
    turn.width_px = 480;
    turn.height_px = 360;
    turn.frame_count = 300;
    turn.calm_turn = true;
    turn.sensor_noise = false;
    const simulation::ActorSequence actor(model, turn);
    focal_px_ = actor.camera().fx;
    folder_ = std::make_unique<test::TemporaryFolder>();
    simulation::VideoWriter video(folder_->path() / "turn.mkv", turn.width_px, turn.height_px,
                                  kFramesPerSecond);  // as slow as it is
    for (int frame = 0; frame < 30; ++frame) {
      video.append(actor.render(frame, nullptr).picture);
    }
    for (int frame = 30; frame < turn.frame_count; frame += 5) {
      video.append(actor.render(frame, nullptr).picture);
    }
    video.finish();
    turn.seed = 77;
    simulation::VideoWriter other(folder_->path() / "other.mkv", turn.width_px, turn.height_px,
                                  kFramesPerSecond);
    other.append(simulation::ActorSequence(model, turn).render(0, nullptr).picture);
    other.finish();
#endif
  }
  static void TearDownTestSuite() {
    folder_.reset();
  }

  void SetUp() override {
#ifdef FACET_SANITIZED
    GTEST_SKIP() << "minutes under a sanitizer; the parts have tests of their own";
#endif
    config_.model_file = test::default_model();
    config_.tracker.landmark_nets = test::assets() / "mediapipe" / "face_mesh_solution_packed_assets.data";
    config_.gpu_device = kNoDevice;
    for (const auto& needed : {config_.model_file, config_.tracker.landmark_nets}) {
      if (!std::filesystem::exists(needed)) {
        GTEST_SKIP() << needed << " is not there: packaging/prepare makes it";
      }
    }
    config_.source.path = folder_->path() / "turn.mkv";
  }

  std::vector<Frame> pictures(const std::string& name) const {
    camera::CameraConfig source;
    source.path = folder_->path() / name;
    const auto video = camera::open_camera(source);
    video->start();
    std::vector<Frame> out;
    Frame frame;
    for (CaptureOutcome outcome = video->next(frame, 1s); outcome != CaptureOutcome::EndOfStream;
         outcome = video->next(frame, 1s)) {
      if (outcome == CaptureOutcome::Delivered) {
        out.push_back(frame);
      }
    }
    return out;
  }

  static Frame black(Frame picture) {
    picture.pixels = std::shared_ptr<const std::uint8_t[]>(
        new std::uint8_t[picture.stride_bytes * static_cast<std::size_t>(picture.height_px)]());
    return picture;
  }

  static inline std::unique_ptr<test::TemporaryFolder> folder_;
  static inline float focal_px_ = 0;
  ShadingConfig config_;
};

/// From his own recording, unasked: what is followed is nearer to the truth's camera, goes with the meshes,
/// and a stop does not wait for the solve.
TEST_F(ATurningHead, IsLearnedFromItsRecording) {
  config_.learn_ahead = true;
  ShadingParts stages = open_shading(config_);
  stages.coarse->prepare([] { return true; });
  const LearnedPerson& learned = stages.coarse->learned();
  ASSERT_NE(learned.model, nullptr) << learned.note;
  EXPECT_EQ(learned.model->identity_count(), 0);
  stages.pictures->start();
  FrameSet set;
  while (stages.pictures->next(set, 100ms) == CaptureOutcome::Timeout) {
  }
  const track::TrackResult& first = stages.coarse->process(set.frames);
  EXPECT_EQ(first.state, mesh::TrackingState::Tracking) << "known from the first frame on";
  EXPECT_NEAR(first.camera.fx / focal_px_, 1, 0.08);

  ShadingParts stopped = open_shading(config_);
  int asked = 0;
  stopped.coarse->prepare([&] { return ++asked < 150; });  // the solve has begun by then
  EXPECT_LT(asked, 160);
  EXPECT_EQ(stopped.coarse->learned().model, nullptr);
}

/// Live: beside the frames, exchanged when no take is recorded, left for another person.
TEST_F(ATurningHead, IsLearnedBesideTheFrames) {
  const auto model = std::make_shared<const face::FaceModel>(face::FaceModel::load(config_.model_file));
  LearningTracker tracker(model, config_.tracker);
  const std::vector<Frame> turn = pictures("turn.mkv");
  std::int64_t now_ns = 0;
  const auto show = [&](Frame picture) -> const track::TrackResult& {
    picture.media_time_ns = now_ns += kStep_ns;
    return tracker.process({&picture, 1});
  };
  for (int time = 0; time < 2; ++time) {  // the first is over before it is known who it is
    for (const Frame& picture : turn) {
      show(picture);
    }
  }
  const track::TrackResult before = show(turn.front());
  ASSERT_EQ(before.state, mesh::TrackingState::Tracking);
  EXPECT_EQ(before.subject, 1U);
  tracker.keep_model(true);
  for (int i = 0; i < 3 * kFramesPerSecond; ++i) {  // it has done its turning
    show(turn.front());
  }
  ASSERT_STREQ(to_string(tracker.learned().learning->state), "solving") << tracker.learned().note;
  while (tracker.learned().note.empty()) {  // the solve ends, and says how
    show(turn.front());
    std::this_thread::sleep_for(50ms);
  }
  ASSERT_THAT(tracker.learned().note, HasSubstr("waits for the end of the take"));
  EXPECT_EQ(tracker.learned().model, nullptr);
  EXPECT_EQ(show(turn.front()).subject, 1U);

  tracker.keep_model(false);
  const track::TrackResult after = show(turn.front());
  ASSERT_NE(tracker.learned().model, nullptr) << tracker.learned().note;
  EXPECT_THAT(tracker.learned().note, HasSubstr("its own shape is followed"));
  EXPECT_EQ(after.state, mesh::TrackingState::Tracking) << "without another acquisition";
  EXPECT_EQ(after.subject, 2U);
  EXPECT_EQ(after.identity.size(), 0U);
  EXPECT_LT(std::abs(after.camera.fx / focal_px_ - 1), std::abs(before.camera.fx / focal_px_ - 1));
  EXPECT_NEAR(after.camera.fx / focal_px_, 1, 0.08);
  EXPECT_NEAR(
      (after.camera_from_head.translation().head<2>() - before.camera_from_head.translation().head<2>())
          .norm(),
      0, 15);

  const Frame stranger = pictures("other.mkv").front();
  for (int i = 0; i < 12; ++i) {
    show(black(stranger));
  }
  EXPECT_NE(tracker.learned().model, nullptr) << "nobody came";
  for (int i = 0; i < 60 && tracker.learned().model != nullptr; ++i) {
    show(stranger);
  }
  EXPECT_EQ(tracker.learned().model, nullptr) << "somebody else is not followed with this shape";
  EXPECT_EQ(tracker.learned().learning->person, nullptr) << "nor kept";
  for (int i = 0; i < 200 && show(stranger).subject != 3; ++i) {
  }
  EXPECT_EQ(show(stranger).subject, 3U);
  EXPECT_EQ(show(stranger).state, mesh::TrackingState::Tracking);
  EXPECT_EQ(show(stranger).identity.size(), static_cast<std::size_t>(model->identity_count()));
}

/// What is being solved of somebody counts for nobody, once they are to be forgotten, and a stop breaks it
/// off.
TEST_F(ATurningHead, IsForgottenWhileItIsLearned) {
  const auto model = std::make_shared<const face::FaceModel>(face::FaceModel::load(config_.model_file));
  auto tracker = std::make_unique<LearningTracker>(model, config_.tracker);
  std::int64_t now_ns = 0;
  const std::vector<Frame> turn = pictures("turn.mkv");
  const auto show = [&](Frame picture) {
    picture.media_time_ns = now_ns += kStep_ns;
    tracker->process({&picture, 1});
  };
  const auto turn_twice = [&] {
    for (int time = 0; time < 2; ++time) {
      for (const Frame& picture : turn) {
        show(picture);
      }
    }
    // What was begun before may take a while to end, where others want the processors.
    for (int i = 0; i < 3000 && tracker->learned().learning->state != LearningStatus::State::Solving; ++i) {
      show(turn.front());
      std::this_thread::sleep_for(10ms);
    }
    const LearningStatus& learning = *tracker->learned().learning;
    EXPECT_STREQ(to_string(learning.state), "solving")
        << "turned " << learning.turned_left_deg << " and " << learning.turned_right_deg << " degrees, "
        << learning.seen_deg.size() << " pictures";
  };
  turn_twice();
  tracker->reset_identity();
  EXPECT_STREQ(to_string(tracker->learned().learning->state), "looking");
  EXPECT_TRUE(tracker->learned().learning->seen_deg.empty());
  // Until the solve that counts no more is over and the next one is under way: it is nobody's.
  turn_twice();
  EXPECT_EQ(tracker->learned().model, nullptr);
  tracker->request_stop();
  tracker.reset();
}

}  // namespace
}  // namespace facet::pipeline
