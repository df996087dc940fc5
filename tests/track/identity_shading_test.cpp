#include "track/identity_shading.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "render/renderer.hpp"
#include "simulation/actor_sequence.hpp"
#include "support/frames.hpp"
#include "support/paths.hpp"
#include "track/tracker.hpp"

namespace facet::track {
namespace {

/// The tracker with the real nets and the built model before virtual actors.
class IdentityShadingTest : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(test::landmark_nets()) || !std::filesystem::exists(test::default_model())) {
      GTEST_SKIP() << test::landmark_nets() << " or " << test::default_model()
                   << " is missing: run packaging/prepare";
    }
    model = std::make_unique<face::FaceModel>(face::FaceModel::load(test::default_model()));
  }

  /// rms distance of the resting faces of two identities over the face skin, mm, size and pose taken out.
  double distance_mm(const std::vector<float>& a, const std::vector<float>& b) const {
    mesh::Vertices from;
    mesh::Vertices to;
    model->evaluate(a, {}, from);
    model->evaluate(b, {}, to);
    std::vector<Eigen::Index> skin;
    for (Eigen::Index v = 0; v < from.cols(); ++v) {
      if (model->control.refinable[static_cast<std::size_t>(v)] != 0) {
        skin.push_back(v);
      }
    }
    const Eigen::MatrixXd p = from(Eigen::all, skin).cast<double>();
    const Eigen::MatrixXd q = to(Eigen::all, skin).cast<double>();
    const Eigen::MatrixXd similarity = Eigen::umeyama(p, q, true);
    const Eigen::MatrixXd moved =
        (similarity.topLeftCorner(3, 3) * p).colwise() + Eigen::VectorXd(similarity.topRightCorner(3, 1));
    return std::sqrt((moved - q).squaredNorm() / static_cast<double>(skin.size()));
  }

  std::unique_ptr<face::FaceModel> model;
};

TEST_F(IdentityShadingTest, FindsThePersonNearerThanLandmarksAlone) {
  double by_landmarks_mm = 0;
  double with_shading_mm = 0;
  for (const std::uint64_t seed : {88U, 110U}) {
    simulation::ActorSequenceConfig config;
    config.seed = seed;
    config.width_px = 400;
    config.height_px = 300;
    config.frame_count = 60;
    config.rays_per_pixel = 1;
    const simulation::ActorSequence sequence(*model, config);
    TrackerConfig tracking{.landmark_nets = test::landmark_nets(), .intrinsics = {}};
    Tracker shaded(*model, tracking);
    tracking.identity_shading = false;
    Tracker plain(*model, tracking);
    for (int index = 0; index < config.frame_count; index += 6) {
      Frame frame = render::to_frame(sequence.render(index, nullptr).picture);
      frame.media_time_ns = index * std::int64_t{33'333'333};
      shaded.process(frame);
      plain.process(frame);
    }
    ASSERT_TRUE(shaded.settle_subject());
    ASSERT_TRUE(plain.settle_subject());
    const auto error_mm = [&](const Tracker& tracker) {
      const Eigen::VectorXf identity = tracker.person()->shape.identity.cast<float>();
      return distance_mm({identity.begin(), identity.end()}, sequence.identity());
    };
    by_landmarks_mm += error_mm(plain);
    with_shading_mm += error_mm(shaded);
    RecordProperty("seed" + std::to_string(seed),
                   std::to_string(error_mm(plain)) + " to " + std::to_string(error_mm(shaded)));
  }
  EXPECT_LT(with_shading_mm, 0.95 * by_landmarks_mm);
}

TEST_F(IdentityShadingTest, SaysNothingWhereNothingIsSeen) {
  IdentityShading shading(*model);
  FrameState state;
  state.expression.setZero(model->expression_count());
  const SubjectShape shape{Eigen::VectorXd::Zero(model->identity_count()), 600};
  const FrameState* const states[] = {&state, &state};
  shading.add_frame({}, nullptr);  // a view that showed no face
  Frame black;
  black.width_px = 320;
  black.height_px = 240;
  black.stride_bytes = 320 * 4;
  black.pixels = std::make_shared<std::uint8_t[]>(black.stride_bytes * 240);
  landmark::FaceLandmarks face;
  face.points_px.setZero(3, landmark::landmark_count);
  for (Eigen::Index l = 0; l < landmark::landmark_count; ++l) {
    face.points_px.col(l) << 110 + static_cast<float>(l % 20) * 5, 70 + static_cast<float>(l / 20) * 4, 0;
  }
  shading.add_frame(black, &face);
  EXPECT_EQ(shading.frame_count(), 2);
  EXPECT_FALSE(shading.evidence(shape, {159.5, 119.5}, states));

  IdentityShading behind(*model);  // the head stands outside the picture
  behind.add_frame(black, &face);
  state.pose.translation_mm = {5000, 0, 600};
  EXPECT_FALSE(behind.evidence(shape, {159.5, 119.5}, {states, 1}));
}

}  // namespace
}  // namespace facet::track
