// A head that turns is learned: from its recording before the first frame, live beside the frames.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "face/person_model.hpp"
#include "facet/error.hpp"
#include "pipeline/learning_tracker.hpp"
#include "pipeline/observe_head.hpp"
#include "pipeline/refined_relief.hpp"
#include "pipeline/shading_parts.hpp"
#include "render/video_writer.hpp"
#include "simulation/actor_sequence.hpp"
#include "support/lamp_lines.hpp"
#include "support/paths.hpp"

namespace facet::pipeline {
namespace {

using namespace std::chrono_literals;
using ::testing::Each;
using ::testing::FloatNear;
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
    render::VideoWriter video(folder_->path() / "turn.mkv", turn.width_px, turn.height_px,
                              kFramesPerSecond);  // as slow as it is
    for (int frame = 0; frame < 30; ++frame) {
      video.append(actor.render(frame, nullptr).picture);
    }
    for (int frame = 30; frame < turn.frame_count; frame += 5) {
      video.append(actor.render(frame, nullptr).picture);
    }
    video.finish();
    turn.seed = 77;
    render::VideoWriter other(folder_->path() / "other.mkv", turn.width_px, turn.height_px, kFramesPerSecond);
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

  /// The picture while lamps are on: the first lights its left half, the second its right half.
  static Frame lit(Frame picture, LineMask on) {
    const std::size_t bytes = picture.stride_bytes * static_cast<std::size_t>(picture.height_px);
    const std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[bytes]);
    std::uint8_t* const lit_pixels = pixels.get();
    const std::uint8_t* const given = picture.pixels.get();
    for (std::size_t i = 0; i < bytes; ++i) {
      const bool left = i % picture.stride_bytes < picture.stride_bytes / 2;
      const bool is_lit = (on & (left ? 1U : 2U)) != 0;
      lit_pixels[i] = static_cast<std::uint8_t>(std::min(255, given[i] * (is_lit ? 5 : 3) / 3));
    }
    picture.pixels = pixels;
    return picture;
  }

  static inline std::unique_ptr<test::TemporaryFolder> folder_;
  static inline float focal_px_ = 0;
  ShadingConfig config_;
};

/// Stands in for a device: every other picture shows a good deal more of a relief than is known, those
/// between a little; the first ones fail.
class MoreRelief final : public refine::RefineStage {
 public:
  explicit MoreRelief(int failing, refine::RefineOutcome failure = refine::RefineOutcome::NumericalFailure)
      : failing_(failing), failure_(failure) {}
  std::string device() const override { return "scripted"; }
  void set_subject(const refine::SubjectSetup& subject) override { known_mm_ = subject.relief_mm; }
  void restart() override {}
  refine::RefineOutcome refine(const refine::RefineInput& input, refine::RefineOutput& output) override {
    EXPECT_FALSE(input.image.empty());
    output.displacements_mm = known_mm_;
    for (float& mm : output.displacements_mm) {
      mm += count_ % 2 == 0 ? 0.6F : 0.2F;
    }
    const bool fails = count_++ < failing_;
    output.failure = fails ? "scripted failure" : "";
    return fails ? failure_ : refine::RefineOutcome::Refined;
  }

 private:
  int failing_;
  refine::RefineOutcome failure_;
  int count_ = 0;
  std::vector<float> known_mm_;
};

TEST_F(ATurningHead, ItsReliefIsTheMeanOfWhatItsPicturesShow) {
  ShadingParts parts = open_shading(config_);
  const ObservedHead head = observe_head(parts, config_.frames, {}, [](std::uint64_t) { return true; });
  const std::optional<person::Observed> observed = head.keyframes.observed(6);
  ASSERT_TRUE(observed);
  ASSERT_EQ(observed->keyframes.size(), 6U);
  const face::FaceModel& model = *parts.model;
  face::FaceModel own =
      face::person_model(model, observed->identity,
                         model.contract_identity(observed->identity).neutral_mm.cast<double>(), "him");
  own.skin.width = own.skin.height = 300;
  own.skin.texels_per_unit = 299;
  own.skin.relief_mm.assign(std::size_t{300} * 300, 1);
  track::TrackerConfig tracker = config_.tracker;
  tracker.intrinsics = observed->camera;
  const auto refined_mm = [&](int failing, std::string& missed, int asked = 1000) {
    face::FaceModel refined = own;
    missed = refine_relief(refined, *observed, tracker,
                           {{.max_levels = 1}, [&] { return std::make_unique<MoreRelief>(failing); }},
                           [&] { return asked-- > 0; });
    std::vector<float> relief_mm = face::relief_at(refined.skin, model.control.texture_coordinates);
    std::vector<float> of_skin;
    for (std::size_t v = 0; v < relief_mm.size(); ++v) {
      const auto at = model.control.texture_coordinates.col(static_cast<Eigen::Index>(v)).array();
      if (model.control.refinable[v] != 0 && at.minCoeff() > 0.01F && at.maxCoeff() < 0.99F) {
        of_skin.push_back(relief_mm[v]);
      }
    }
    return of_skin;
  };
  std::string missed;
  EXPECT_THAT(refined_mm(0, missed), Each(FloatNear(1.4F, 0.01F)));
  EXPECT_EQ(missed, "");
  EXPECT_THAT(refined_mm(1, missed), Each(FloatNear(1.36F, 0.01F))) << "of those that were refined";
  EXPECT_EQ(missed, "");
  EXPECT_THAT(refined_mm(4, missed), Each(FloatNear(1, 1e-5F))) << "too few";
  EXPECT_THAT(missed, HasSubstr("scripted failure"));
  for (const int asked : {0, 7, 12, 13, 16}) {  // pictures are tracked twice, then refined
    EXPECT_THAT(refined_mm(0, missed, asked), Each(FloatNear(1, 1e-5F))) << "broken off after " << asked;
    EXPECT_EQ(missed, "");
  }
  missed = refine_relief(
      own, *observed, tracker,
      {{.max_levels = 1}, [] { return std::make_unique<MoreRelief>(1, refine::RefineOutcome::DeviceLost); }},
      [] { return true; });
  EXPECT_THAT(missed, HasSubstr("scripted failure")) << "a lost device is not asked again";
  missed = refine_relief(
      own, *observed, tracker,
      {{},
       []() -> std::unique_ptr<refine::RefineStage> { throw Error(ErrorKind::NoDevice, "scripted: none"); }},
      [] { return true; });
  EXPECT_THAT(missed, HasSubstr("scripted: none"));
}

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

/// The lamps fire while the head is looked at to be learned; they are off before, after, and where nobody is
/// there.
TEST_F(ATurningHead, IsSeenUnderTheLampsThatFireInTurn) {
  const auto model = std::make_shared<const face::FaceModel>(face::FaceModel::load(config_.model_file));
  std::atomic<LineMask> on = 0;
  auto lines = std::make_unique<test::LampLines>(on);
  test::LampLines& wires = *lines;
  LearningTracker tracker(model, config_.tracker, {}, std::make_unique<LampBurst>(std::move(lines), 2, 1000));
  const std::vector<Frame> turn = pictures("turn.mkv");
  std::int64_t now_ns = 0;
  std::vector<LineMask> was;
  mesh::TrackingState state = mesh::TrackingState::Searching;
  const auto show = [&](const Frame& given) {
    Frame picture = lit(given, on);
    was.push_back(on);
    picture.media_time_ns = now_ns += kStep_ns;
    state = tracker.process({&picture, 1}).state;
  };
  const auto learning = [&] { return *tracker.learned().learning; };
  tracker.burst();
  for (std::size_t i = 0; i < 2 * turn.size() && state != mesh::TrackingState::Tracking; ++i) {
    show(turn[i % turn.size()]);
  }
  for (int i = 0; i < 3; ++i) {
    show(turn.front());
  }
  ASSERT_EQ(state, mesh::TrackingState::Tracking);
  EXPECT_THAT(was, Each(LineMask{0})) << "nobody was there when they were asked for";
  EXPECT_EQ(learning().lamps, 2);
  EXPECT_FLOAT_EQ(learning().burst_s, 3);
  EXPECT_EQ(learning().bursts, 0);

  const auto burst = [&](int frames) {
    was.clear();
    tracker.burst();
    for (int i = 0; i < frames; ++i) {
      show(turn.front());
    }
  };
  burst(3 * kFramesPerSecond + 3);
  EXPECT_EQ(learning().bursts, 1) << learning().note;
  EXPECT_EQ(learning().lights, 3) << learning().note << "; the lamps, and none";
  EXPECT_EQ(on.load(), 0U);
  for (const LineMask lamps : {0U, 1U, 2U}) {
    EXPECT_GE(std::count(was.begin(), was.end(), lamps), kFramesPerSecond - 1) << lamps;
  }
  wires.fails = true;
  burst(2);
  EXPECT_EQ(learning().bursts, 2);
  EXPECT_EQ(learning().lights, 0);
  EXPECT_THAT(learning().note, HasSubstr("can't be switched: they may still be on: line 1 was pulled out"));
  wires.fails = false;
  tracker.burst();
  for (int i = 0; i < kFramesPerSecond + 2; ++i) {
    show(turn.front());
  }
  EXPECT_EQ(on.load(), 2U);
  tracker.burst();
  show(turn.front());
  EXPECT_EQ(on.load(), 2U) << "it goes on, and does not begin anew";
  tracker.reset_identity();
  EXPECT_EQ(on.load(), 0U) << "nobody is learned any more";
  EXPECT_EQ(learning().bursts, 0);
}

/// Of a video the frames that are said to be a burst are kept as such.
TEST_F(ATurningHead, ABurstOfAVideoIsFound) {
  const std::vector<Frame> turn = pictures("turn.mkv");
  const Frame& front = turn.front();
  const std::uint64_t first = turn.size();
  {
    render::VideoWriter video(folder_->path() / "burst.mkv", front.width_px, front.height_px,
                              kFramesPerSecond);
    for (const Frame& picture : turn) {
      video.append(render::to_picture(picture));
    }
    for (const LineMask on : {1U, 1U, 1U, 1U, 2U, 2U, 2U, 2U}) {
      video.append(render::to_picture(lit(front, on)));
    }
    video.finish();
  }
  config_.source.path = folder_->path() / "burst.mkv";
  const auto observed = [&](const std::optional<FrameRange>& burst) {
    ShadingParts parts = open_shading(config_);
    const ObservedHead head = observe_head(parts, config_.frames, burst, [](std::uint64_t) { return true; });
    EXPECT_EQ(head.frames, first + 8);
    return head.keyframes.observed(14, 12);
  };
  const auto with = observed(FrameRange{first, first + 8});
  ASSERT_TRUE(with);
  EXPECT_EQ(with->light_count(), 2);
  for (const person::Keyframe& keyframe : with->burst) {
    EXPECT_GE(keyframe.sequence, first);
  }
  const auto without = observed(std::nullopt);
  ASSERT_TRUE(without);
  EXPECT_TRUE(without->burst.empty());
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
