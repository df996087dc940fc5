#include "person/enrolment.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <utility>

#include "facet/assets.hpp"
#include "report/evaluation.hpp"
#include "simulation/actor_sequence.hpp"

namespace facet::person {
namespace {

constexpr double kGuess = 0.85;  // of the true focal length

class EnrolmentTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(default_model_file())) {
      GTEST_SKIP() << "no " << default_model_file() << ": facet model build makes it";
    }
    model_ = face::FaceModel::load(default_model_file());
  }

  /// What a tracker that guesses a mean face and a focal length that is short would have of an actor's calm
  /// turn.
  Observed look(const simulation::ActorSequence& actor, const std::vector<int>& frames) const {
    Observed out;
    out.camera = actor.camera();
    out.camera.fx *= static_cast<float>(kGuess);
    out.camera.fy = out.camera.fx;
    out.identity.assign(static_cast<std::size_t>(model_.identity_count()), 0);
    out.rest = Eigen::VectorXd::Zero(model_.expression_count());
    out.usual_reprojection_px = 1;
    for (const int index : frames) {
      const simulation::SyntheticFrame frame = actor.render(index, nullptr);
      Keyframe keyframe;
      keyframe.sequence = static_cast<std::uint64_t>(index);
      keyframe.camera_from_head = frame.camera_from_head.cast<double>();
      keyframe.camera_from_head.translation().z() *= kGuess;
      keyframe.expression = out.rest;
      std::tie(keyframe.yaw_deg, keyframe.pitch_deg) = orientation_deg(keyframe.camera_from_head);
      keyframe.picture = {0, 0, frame.picture.width_px, frame.picture.height_px, frame.picture.rgb};
      out.keyframes.push_back(std::move(keyframe));
    }
    return out;
  }

  /// Mean distance of the skin from the actor's face at rest, mm.
  double error_mm(const Eigen::Matrix3Xd& neutral_mm, const report::Truth& truth) const {
    report::Reconstruction mesh;
    mesh::apply(surface_rows(model_), neutral_mm.cast<float>().eval(), mesh.vertices_mm);
    mesh.normals = Eigen::Matrix3Xf::Zero(3, mesh.vertices_mm.cols());
    for (std::int32_t v = 0; v < model_.vertex_count(); ++v) {
      if (model_.control.refinable[static_cast<std::size_t>(v)] != 0) {
        mesh.measured.push_back(v);
      }
    }
    mesh.normals.row(2).setOnes();
    const report::Comparison compared = report::measure(
        mesh, truth, report::align_from({&mesh, &truth}, report::Alignment::Similarity, maths::Similarity()));
    double sum = 0;
    for (const float distance : compared.signed_distance_mm) {
      sum += std::isfinite(distance) ? static_cast<double>(std::abs(distance)) : 10;
    }
    return sum / static_cast<double>(mesh.measured.size());
  }

  face::FaceModel model_;
};

TEST_F(EnrolmentTest, AnActorsTurnShowsTheShape) {
#ifdef FACET_SANITIZED
  GTEST_SKIP() << "minutes under a sanitizer; the parts have tests of their own";
#endif
  simulation::ActorSequenceConfig config;
  config.seed = 352;
  config.width_px = 480;
  config.height_px = 360;
  config.frame_count = 300;
  config.calm_turn = true;
  config.sensor_noise = false;
  const simulation::ActorSequence actor(model_, config);
  const Observed observed = look(actor, {30, 45, 75, 105, 135, 150, 165});
  EnrolmentOptions options;
  options.rounds = 2;
  options.chart_texels = 448;
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
  const double before = error_mm(model_.core_row(0, 0).cast<double>(), truth);
  const double after = error_mm(learned.neutral_mm, truth);
  EXPECT_LT(after, 0.7 * before) << "before: " << before;
  EXPECT_EQ(learned.keyframes.size(), observed.keyframes.size());
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
