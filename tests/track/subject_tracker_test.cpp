#include "track/subject_tracker.hpp"

#include <gtest/gtest.h>

#include <array>
#include <functional>
#include <limits>
#include <optional>

#include "allocation_counter.hpp"
#include "support/synthetic_model.hpp"
#include "synthetic_landmarks.hpp"

namespace facet::track {
namespace {

using mesh::TrackingState;

constexpr std::int64_t kFrameNs = 33'000'000;

class SubjectTrackerTest : public testing::Test {
 protected:
  SubjectTrackerTest()
      : face_model(test::synthetic_model()),
        model(face_model),
        prior(face_model.expression_names, face_model.expression_sigma, {}, model.sees_gaze()),
        tracker(model, prior, {}) {}

  /// A person who turns the head and talks, at frame `frame`.
  test::SyntheticView acting(const Eigen::VectorXd& identity, int frame) const {
    test::SyntheticView view;
    view.identity = identity;
    const double t = 0.1 * frame;
    view.pose.rotation = rotation_from_vector(Eigen::Vector3d(0.15 * std::sin(1.3 * t), 0.35 * std::sin(t),
                                                              0.1 * std::sin(0.7 * t))) *
                         view.pose.rotation;
    view.pose.translation_mm = Eigen::Vector3d(25 * std::sin(0.5 * t), 10 * std::cos(0.4 * t), 550);
    view.expression = Eigen::VectorXd::Zero(model.expression_count());
    view.expression[0] = std::max(0.0, 0.5 * std::sin(1.7 * t));
    view.expression[3] = std::max(0.0, 0.6 * std::sin(0.6 * t));
    view.expression[4] = view.expression[3];
    return view;
  }

  const SubjectFrame& show(const landmark::FaceLandmarks* face, bool acquired = false) {
    now_ns += kFrameNs;
    const SubjectFrame& result = tracker.process(face, acquired, width_px, height_px, now_ns);
    if (result.fitted) {
      EXPECT_TRUE(result.face.pose.rotation.allFinite());
      EXPECT_TRUE(result.face.pose.translation_mm.allFinite());
      EXPECT_TRUE(result.face.expression.allFinite());
      EXPECT_GE(result.face.expression.minCoeff(), 0.0);
      EXPECT_LE(result.face.expression.maxCoeff(), 1.0);
      EXPECT_LT(result.face.pose.translation_mm.norm(), 50'000.0);
    } else {
      EXPECT_NE(result.state, TrackingState::Tracking);
    }
    return result;
  }

  /// The person acts for `frames` frames; returns the last one.
  const SubjectFrame& act(const Eigen::VectorXd& identity, int frames, bool acquired_first = false) {
    const SubjectFrame* last = nullptr;
    for (int f = 0; f < frames; ++f) {
      const auto face = test::synthetic_landmarks(model, acting(identity, time++), 0.8, random);
      last = &show(&face, acquired_first && f == 0);
    }
    return *last;
  }

  void acquire(const Eigen::VectorXd& identity) {
    for (int f = 0; f < 150; ++f) {
      if (act(identity, 1, f == 0 && !tracker.has_person()).state == TrackingState::Tracking) {
        act(identity, 40);
        return;
      }
    }
    FAIL() << "never tracked";
  }

  std::mt19937 random{40};
  face::FaceModel face_model;
  LandmarkModel model;
  ExpressionPrior prior;
  SubjectTracker tracker;
  int width_px = 1280;
  int height_px = 720;
  std::int64_t now_ns = 1'000'000'000;
  int time = 0;
};

TEST_F(SubjectTrackerTest, SearchesAcquiresAndTracks) {
  EXPECT_EQ(show(nullptr).state, TrackingState::Searching);
  const Eigen::VectorXd identity = test::random_identity(model, random);
  const SubjectFrame& first = act(identity, 1, true);
  EXPECT_EQ(first.state, TrackingState::Acquiring);
  EXPECT_TRUE(first.fitted) << "a provisional face from the first frame on";
  EXPECT_EQ(first.subject, 0U);
  int acquiring = 1;
  while (act(identity, 1).state == TrackingState::Acquiring) {
    ASSERT_LT(++acquiring, 120) << "never ends";
  }
  const SubjectFrame& result = act(identity, 20);
  EXPECT_EQ(result.state, TrackingState::Tracking);
  EXPECT_EQ(result.subject, 1U);
  EXPECT_LT(result.relative_residual, 0.02);
  EXPECT_LT((tracker.shape().identity - identity).cwiseAbs().maxCoeff(), 1.0);
}

TEST_F(SubjectTrackerTest, ShapeAndFocalLengthAreHeldWhileTracking) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire(identity);
  const SubjectShape before = tracker.shape();
  const std::uint64_t version = act(identity, 1).shape_version;
  EXPECT_EQ(act(identity, 60).shape_version, version);
  EXPECT_EQ(tracker.shape().focal_px, before.focal_px);
  EXPECT_EQ(tracker.shape().identity, before.identity);
}

TEST_F(SubjectTrackerTest, LosesSearchesAndKnowsThePersonAgain) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire(identity);
  EXPECT_EQ(show(nullptr).state, TrackingState::Lost);
  EXPECT_FALSE(tracker.process(nullptr, false, width_px, height_px, now_ns).fitted);
  for (int f = 0; f < 40; ++f) {
    show(nullptr);
  }
  EXPECT_EQ(show(nullptr).state, TrackingState::Searching);
  const SubjectFrame& back = act(identity, 1, true);
  EXPECT_EQ(back.state, TrackingState::Tracking) << "no second acquisition for the same person";
  const SubjectFrame& later = act(identity, 40);
  EXPECT_EQ(later.state, TrackingState::Tracking);
  EXPECT_EQ(later.subject, 1U);
}

TEST_F(SubjectTrackerTest, AnotherPersonGetsANewIdentity) {
  Eigen::VectorXd identity = Eigen::VectorXd::Constant(model.identity_count(), 1.2);
  acquire(identity);
  for (int f = 0; f < 40; ++f) {
    show(nullptr);
  }
  act(-identity, 1, true);
  const SubjectFrame& result = act(-identity, 150);
  EXPECT_EQ(result.state, TrackingState::Tracking);
  EXPECT_EQ(result.subject, 2U);
  EXPECT_LT(tracker.shape().identity.dot(identity), 0.0);
}

TEST_F(SubjectTrackerTest, StaysOnItsOwnFaceWhenLandmarksHopToAnother) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire(identity);
  auto view = acting(identity, time);
  view.pose.translation_mm.x() += 300;
  const auto other = test::synthetic_landmarks(model, view, 0.8, random);
  const SubjectFrame& result = show(&other);
  EXPECT_TRUE(result.rejected);
  EXPECT_EQ(result.state, TrackingState::Lost);
  EXPECT_EQ(act(identity, 1).state, TrackingState::Tracking);
}

TEST_F(SubjectTrackerTest, AHeadTurnedBeyondSightHasNoMeshAndIsFollowed) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire(identity);
  const auto seen = [&](double turn_rad, float contradiction, double noise_px) -> const SubjectFrame& {
    auto view = acting(identity, time++);
    view.pose.rotation = test::SyntheticView{}.pose.rotation;
    view.pose.rotation = rotation_from_vector(Eigen::Vector3d(0, turn_rad, 0)) * view.pose.rotation;
    auto face = test::synthetic_landmarks(model, view, noise_px, random);
    face.contradiction = contradiction;
    return show(&face);
  };
  EXPECT_TRUE(seen(0.1, 0.08F, 0.8).fitted)
      << "of a face that looks this way, the nets' contradiction says nothing";
  EXPECT_TRUE(seen(0.6, 0.03F, 0.8).fitted);
  const auto look_away = [&] {
    for (int f = 0; f < 40; ++f) {
      // 0.043: less than it takes to lose the face, more than it takes to have it back.
      const SubjectFrame& away = seen(0.8, f % 2 == 0 ? 0.06F : 0.043F, 0.8);
      EXPECT_FALSE(away.fitted);
      EXPECT_TRUE(away.beyond_sight);
      EXPECT_FALSE(away.rejected) << "or the face is looked for elsewhere";
    }
  };
  look_away();
  show(nullptr);
  for (int f = 0; f < 15; ++f) {
    const SubjectFrame& back = seen(0.7, 0.03F, 3.0);
    EXPECT_EQ(back.state, TrackingState::Tracking) << f;
    EXPECT_EQ(back.subject, 1U) << "a turned head always fits worse: nobody else for that";
  }
  act(identity, 15);
  look_away();
  for (int f = 0; f < 15; ++f) {
    const SubjectFrame& back = seen(0.2, 0.02F, 3.0);
    EXPECT_EQ(back.state, TrackingState::Tracking) << f;
    EXPECT_EQ(back.subject, 1U) << "it was followed all the time: nobody else";
  }
}

TEST_F(SubjectTrackerTest, ResetIdentityAcquiresAnew) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire(identity);
  tracker.reset_identity();
  EXPECT_FALSE(tracker.has_person());
  EXPECT_EQ(act(identity, 1).state, TrackingState::Acquiring);
  acquire(identity);
  EXPECT_EQ(act(identity, 1).subject, 2U);
}

TEST_F(SubjectTrackerTest, AnAdoptedSubjectIsTrackedFromTheFirstFrame) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire(identity);
  SubjectTracker second(model, prior, {});
  ASSERT_TRUE(second.adopt(tracker.person(), width_px, height_px));
  const auto face = test::synthetic_landmarks(model, acting(identity, 0), 0.8, random);
  const SubjectFrame& result = second.process(&face, true, width_px, height_px, 5);
  EXPECT_EQ(result.state, TrackingState::Tracking);
  EXPECT_EQ(second.shape().identity, tracker.shape().identity);

  Person damaged = tracker.person();
  damaged.shape.identity[0] = std::nan("");
  EXPECT_FALSE(second.adopt(damaged, width_px, height_px));
  damaged = tracker.person();
  damaged.shape.identity.conservativeResize(2);
  EXPECT_FALSE(second.adopt(damaged, width_px, height_px));
}

TEST_F(SubjectTrackerTest, KnownIntrinsicsAreUsedAndScaledToTheImage) {
  SubjectTrackerConfig config;
  config.intrinsics =
      CameraIntrinsics{.fx = 450, .fy = 450, .cx = 310, .cy = 185, .width_px = 640, .height_px = 360};
  SubjectTracker known(model, prior, config);
  known.process(nullptr, false, 1280, 720, 0);
  EXPECT_FLOAT_EQ(known.camera().fx, 900);
  EXPECT_FLOAT_EQ(known.camera().cx, 620);
  EXPECT_FLOAT_EQ(known.camera().cy, 370);
}

TEST_F(SubjectTrackerTest, AnotherImageSizeStartsAnew) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire(identity);
  width_px = 640;
  height_px = 480;
  EXPECT_EQ(show(nullptr).state, TrackingState::Searching);
  EXPECT_FALSE(tracker.has_person());
}

/// What a broken landmark net might say: every case in every state, and the tracker must recover from it.
struct Garbage {
  const char* name;
  std::function<void(landmark::FaceLandmarks&, std::mt19937&)> spoil;
};

class SubjectTrackerGarbageTest : public SubjectTrackerTest, public testing::WithParamInterface<Garbage> {};

TEST_P(SubjectTrackerGarbageTest, GivesNoMeshOrAPlausibleOneAndRecovers) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  const auto spoilt = [&](int frames, bool acquired) {
    for (int f = 0; f < frames; ++f) {
      auto face = test::synthetic_landmarks(model, acting(identity, time), 0.8, random);
      GetParam().spoil(face, random);
      show(&face, acquired);
    }
  };
  spoilt(5, true);
  act(identity, 4, true);
  spoilt(5, false);
  acquire(identity);
  spoilt(5, false);
  spoilt(40, true);
  act(identity, 1, true);
  acquire(identity);
  EXPECT_EQ(act(identity, 5).state, TrackingState::Tracking);
}

INSTANTIATE_TEST_SUITE_P(
    Cases, SubjectTrackerGarbageTest,
    testing::Values(
        Garbage{"all_equal", [](landmark::FaceLandmarks& face,
                                std::mt19937&) { face.points_px.colwise() = Eigen::Vector3f(300, 200, 0); }},
        Garbage{"on_a_line",
                [](landmark::FaceLandmarks& face, std::mt19937&) {
                  face.points_px = Eigen::Vector3f(1, 1, 1) *
                                   Eigen::RowVectorXf::LinSpaced(landmark::landmark_count, 0, 500);
                }},
        Garbage{"mirrored",
                [](landmark::FaceLandmarks& face, std::mt19937&) {
                  face.points_px.row(0) = 1279 - face.points_px.row(0).array();
                }},
        Garbage{"upside_down",
                [](landmark::FaceLandmarks& face, std::mt19937&) {
                  face.points_px.row(1) = 719 - face.points_px.row(1).array();
                }},
        Garbage{"huge", [](landmark::FaceLandmarks& face, std::mt19937&) { face.points_px *= 1e9F; }},
        Garbage{"tiny",
                [](landmark::FaceLandmarks& face, std::mt19937&) {
                  face.points_px = face.points_px * 1e-3F;
                  face.interocular_px *= 1e-3F;
                }},
        Garbage{"not_a_number",
                [](landmark::FaceLandmarks& face, std::mt19937&) {
                  face.points_px(1, 100) = std::numeric_limits<float>::quiet_NaN();
                }},
        Garbage{"infinite",
                [](landmark::FaceLandmarks& face, std::mt19937&) {
                  face.points_px(0, 5) = std::numeric_limits<float>::infinity();
                }},
        Garbage{"random",
                [](landmark::FaceLandmarks& face, std::mt19937& random) {
                  std::uniform_real_distribution<float> anywhere(0, 700);
                  face.points_px = Eigen::Matrix3Xf::NullaryExpr(3, landmark::landmark_count,
                                                                 [&] { return anywhere(random); });
                }},
        Garbage{"wrong_size", [](landmark::FaceLandmarks& face,
                                 std::mt19937&) { face.points_px.conservativeResize(3, 100); }},
        Garbage{"stretched",
                [](landmark::FaceLandmarks& face, std::mt19937&) { face.points_px.row(0) *= 2.5F; }}),
    [](const testing::TestParamInfo<Garbage>& tested) { return tested.param.name; });

TEST_F(SubjectTrackerTest, TrackingAllocatesNothing) {
  if (!test::allocations_are_counted()) {
    GTEST_SKIP() << "the sanitizers bring their own allocator";
  }
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire(identity);
  std::vector<landmark::FaceLandmarks> faces;
  for (int f = 0; f < 30; ++f) {
    faces.push_back(test::synthetic_landmarks(model, acting(identity, time++), 0.8, random));
  }
  const std::size_t before = test::allocation_count();
  ASSERT_GT(before, 0U) << "the counter does not count";
  for (const landmark::FaceLandmarks& face : faces) {
    now_ns += kFrameNs;
    tracker.process(&face, false, width_px, height_px, now_ns);
  }
  // Losing and finding the face again is no start-up either.
  tracker.process(nullptr, false, width_px, height_px, now_ns + kFrameNs);
  tracker.process(&faces.back(), true, width_px, height_px, now_ns + 2 * kFrameNs);
  EXPECT_EQ(test::allocation_count() - before, 0U);
}

/// Two calibrated cameras, the second one 23 degrees beside the first.
class TwoViewsTest : public SubjectTrackerTest {
 protected:
  TwoViewsTest() : side(test::side_view({}, 0.4)), both(model, prior, config_with(true)) {}

  SubjectTrackerConfig config_with(bool with_side) const {
    const test::SyntheticView front;
    SubjectTrackerConfig config;
    config.intrinsics = test::side_view(front, 0).intrinsics;
    if (with_side) {
      config.further_views = {side};
    }
    return config;
  }

  /// front_off_mm, side_off_mm: how far beside its place the camera sees the face; none: it sees no face.
  const SubjectFrame& show_both(const Eigen::VectorXd& identity, std::optional<double> front_off_mm,
                                std::optional<double> side_off_mm, double noise_px = 0.8) {
    now_ns += kFrameNs;
    const test::SyntheticView view = acting(identity, time++);
    truth = view.pose;
    const auto seen = [&](const test::SyntheticView& placed, std::optional<double> off_mm) {
      test::SyntheticView moved = placed;
      moved.pose.translation_mm.x() += off_mm.value_or(0);
      return test::synthetic_landmarks(model, moved, noise_px, random);
    };
    const landmark::FaceLandmarks in_front = seen(view, front_off_mm);
    const landmark::FaceLandmarks aside = seen(test::seen_by(side, view), side_off_mm);
    const std::array<ViewLandmarks, 2> views = {ViewLandmarks{front_off_mm ? &in_front : nullptr, false},
                                                ViewLandmarks{side_off_mm ? &aside : nullptr, false}};
    return both.process(views, width_px, height_px, now_ns);
  }

  void acquire_both(const Eigen::VectorXd& identity) {
    for (int f = 0; f < 150; ++f) {
      if (show_both(identity, 0, 0).state == TrackingState::Tracking) {
        return;
      }
    }
    FAIL() << "never tracked";
  }

  double error_mm(const SubjectFrame& result) const {
    return (result.face.pose.translation_mm - truth.translation_mm).norm();
  }

  FurtherCamera side;
  SubjectTracker both;
  Pose truth;
};

TEST_F(TwoViewsTest, ASecondCameraThatSeesNothingChangesNothing) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  SubjectTracker one(model, prior, config_with(false));
  for (int f = 0; f < 60; ++f) {
    now_ns += kFrameNs;
    const auto face = test::synthetic_landmarks(model, acting(identity, time++), 0.8, random);
    const std::array<ViewLandmarks, 2> views = {ViewLandmarks{&face, f == 0}, ViewLandmarks{}};
    const SubjectFrame& expected = one.process(&face, f == 0, width_px, height_px, now_ns);
    const SubjectFrame& found = both.process(views, width_px, height_px, now_ns);
    ASSERT_EQ(found.state, expected.state) << f;
    ASSERT_EQ(found.face.pose.rotation, expected.face.pose.rotation) << f;
    ASSERT_EQ(found.face.pose.translation_mm, expected.face.pose.translation_mm) << f;
    ASSERT_EQ(found.face.expression, expected.face.expression) << f;
    ASSERT_EQ(found.reprojection_px, expected.reprojection_px) << f;
    ASSERT_EQ(found.view_used, (std::vector<std::uint8_t>{1, 0})) << f;
  }
  EXPECT_EQ(both.shape().identity, one.shape().identity);
  EXPECT_EQ(both.shape().focal_px, one.shape().focal_px);
}

TEST_F(TwoViewsTest, TheyKnowTheDistanceAndTheShapeThatOneDoesNot) {
  for (int person = 0; person < 3; ++person) {
    const Eigen::VectorXd identity = test::random_identity(model, random);
    SubjectTracker one(model, prior, config_with(false));
    both.reset_identity();
    double distance_of_one = 0;
    double distance_of_both = 0;
    int frames = 0;
    for (int f = 0; f < 150; ++f) {
      const test::SyntheticView view = acting(identity, time);
      const SubjectFrame& found = show_both(identity, 0, 0, 1.5);
      const auto face = test::synthetic_landmarks(model, view, 1.5, random);
      const SubjectFrame& alone = one.process(&face, false, width_px, height_px, now_ns);
      if (found.state == TrackingState::Tracking && alone.state == TrackingState::Tracking) {
        distance_of_both += error_mm(found);
        distance_of_one += (alone.face.pose.translation_mm - truth.translation_mm).norm();
        ++frames;
      }
    }
    ASSERT_GT(frames, 30);
    EXPECT_LT(distance_of_both, 0.6 * distance_of_one) << "person " << person;
    EXPECT_LT(distance_of_both / frames, 3.0);
    EXPECT_LT((both.shape().identity - identity).norm(), (one.shape().identity - identity).norm());
  }
}

TEST_F(TwoViewsTest, EitherViewAloneIsEnoughToGoOn) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire_both(identity);
  for (const bool front_is_lost : {false, true}) {
    for (int f = 0; f < 20; ++f) {
      const SubjectFrame& result = show_both(identity, front_is_lost ? std::nullopt : std::optional(0.0),
                                             front_is_lost ? std::optional(0.0) : std::nullopt);
      ASSERT_EQ(result.state, TrackingState::Tracking);
      ASSERT_EQ(result.view_used[front_is_lost ? 0 : 1], 0);
      ASSERT_LT(error_mm(result), 12.0) << f;
    }
    ASSERT_LT(error_mm(show_both(identity, 0, 0)), 4.0);
  }
  EXPECT_EQ(show_both(identity, std::nullopt, std::nullopt).state, TrackingState::Lost);
  EXPECT_EQ(both.person().shape.identity.size(), model.identity_count());
}

TEST_F(TwoViewsTest, AViewThatContradictsIsLeftOut) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire_both(identity);
  for (const std::size_t wrong : {std::size_t{0}, std::size_t{1}}) {
    show_both(identity, 0, 0);
    // The landmarks of one camera hop to somebody else.
    const SubjectFrame& result = show_both(identity, wrong == 0 ? 220.0 : 0.0, wrong == 1 ? 220.0 : 0.0);
    ASSERT_EQ(result.state, TrackingState::Tracking) << wrong;
    EXPECT_EQ(result.view_used[wrong], 0);
    EXPECT_EQ(result.view_rejected[wrong], 1);
    EXPECT_EQ(result.view_used[1 - wrong], 1);
    EXPECT_EQ(result.view_rejected[1 - wrong], 0);
    EXPECT_LT(error_mm(result), 12.0);
  }
}

TEST_F(TwoViewsTest, TrackingThemAllocatesNothing) {
  if (!test::allocations_are_counted()) {
    GTEST_SKIP() << "the sanitizers bring their own allocator";
  }
  const Eigen::VectorXd identity = test::random_identity(model, random);
  acquire_both(identity);
  const test::SyntheticView view = acting(identity, time);
  const auto front = test::synthetic_landmarks(model, view, 0.8, random);
  const auto aside = test::synthetic_landmarks(model, test::seen_by(side, view), 0.8, random);
  auto other = view;
  other.pose.translation_mm.x() += 220;
  const auto wrong = test::synthetic_landmarks(model, other, 0.8, random);
  const std::size_t before = test::allocation_count();
  for (const landmark::FaceLandmarks* shown : {&front, &wrong, &front}) {
    now_ns += kFrameNs;
    const std::array<ViewLandmarks, 2> views = {ViewLandmarks{shown, false}, ViewLandmarks{&aside, false}};
    ASSERT_EQ(both.process(views, width_px, height_px, now_ns).state, TrackingState::Tracking);
  }
  EXPECT_EQ(test::allocation_count() - before, 0U);
}

}  // namespace
}  // namespace facet::track
