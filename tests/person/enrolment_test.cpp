#include "person/enrolment.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "actors_turn.hpp"
#include "facet/assets.hpp"

namespace facet::person {
namespace {

class EnrolmentTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(default_model_file())) {
      GTEST_SKIP() << "no " << default_model_file() << ": facet model build makes it";
    }
    model_ = face::FaceModel::load(default_model_file());
  }

  face::FaceModel model_;
};

TEST_F(EnrolmentTest, AnActorsTurnShowsTheShape) {
#ifdef FACET_SANITIZED
  GTEST_SKIP() << "minutes under a sanitizer; the parts have tests of their own";
#endif
  const simulation::ActorSequence actor(model_, actors_turn());
  const Observed observed = look_at(model_, actor);
  EnrolmentOptions options;
  options.rounds = 2;
  options.chart_texels = 448;
  options.skin_texels = 256;
  int last = 0;
  const LearnedShape learned = learn_shape(model_, observed, options, [&](int done, int total) {
    EXPECT_LE(done, total);
    EXPECT_GE(done, last);
    last = done;
    return true;
  });
  // And it lets go when it is told to.
  int asked = 0;
  const LearnedShape stopped = learn_shape(model_, observed, options, [&](int, int) { return ++asked < 3; });
  EXPECT_EQ(asked, 3);
  EXPECT_FALSE(stopped.accepted);
  EXPECT_EQ(stopped.refused, "it was broken off");
  EXPECT_TRUE(learned.accepted) << learned.refused;
  EXPECT_NEAR(learned.focal_px / static_cast<double>(actor.camera().fx), 1, 0.06);
  const report::Truth truth(actor.neutral());
  const double before = error_mm(model_, model_.core_row(0, 0).cast<double>(), truth);
  const double after = error_mm(model_, learned.neutral_mm, truth);
  EXPECT_LT(after, 0.7 * before) << "before: " << before;
  EXPECT_EQ(learned.keyframes.size(), observed.keyframes.size());
  EXPECT_EQ(std::max(learned.skin.chart.width, learned.skin.chart.height), 256);
  EXPECT_EQ(learned.skin.gains.size(), observed.keyframes.size() + observed.burst.size());
}

TEST_F(EnrolmentTest, AHeadThatNeverTurnsIsRefusedAtOnce) {
  Observed observed;
  observed.camera = {800, 800, 319.5F, 239.5F, 640, 480};
  observed.identity.assign(static_cast<std::size_t>(model_.identity_count()), 0);
  observed.rest = Eigen::VectorXd::Zero(model_.expression_count());
  for (const double yaw : {-4.0, 0.0, 30.0}) {
    Keyframe keyframe;
    keyframe.yaw_deg = yaw;
    keyframe.expression = observed.rest;
    keyframe.camera_from_head.translation() = Eigen::Vector3d(0, 0, 600);
    observed.keyframes.push_back(keyframe);
  }
  const LearnedShape learned = learn_shape(model_, observed, {}, {});
  EXPECT_FALSE(learned.accepted);
  EXPECT_THAT(learned.refused,
              ::testing::HasSubstr("not turned far enough to its left with the face at rest (4 degrees"));
}

TEST_F(EnrolmentTest, NothingSeenIsRefused) {
  const LearnedShape learned = learn_shape(model_, {}, {}, {});
  EXPECT_FALSE(learned.accepted);
  EXPECT_FALSE(learned.refused.empty());
}

}  // namespace
}  // namespace facet::person
