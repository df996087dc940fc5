#include "maths/alignment.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "simulation/random.hpp"

namespace facet::maths {
namespace {

Eigen::Matrix3Xf cloud(int count) {
  simulation::Random random(3, 0);
  Eigen::Matrix3Xf points(3, count);
  for (float& value : points.reshaped()) {
    value = random.uniform(-80, 80);
  }
  points.row(2).array() += 600;
  return points;
}

TEST(Alignment, FindsAKnownSimilarity) {
  const Eigen::Matrix3Xf from = cloud(200);
  Similarity known;
  known.scale = 1.17F;
  known.rotation = Eigen::AngleAxisf(0.7F, Eigen::Vector3f(1, 2, -1).normalized()).toRotationMatrix();
  known.translation_mm = {10, -40, 25};
  const Similarity found = best_similarity(from, known.apply(from), true);
  EXPECT_NEAR(found.scale, known.scale, 1e-5F);
  EXPECT_TRUE(found.rotation.isApprox(known.rotation, 1e-4F));
  EXPECT_LT((found.apply(from) - known.apply(from)).cwiseAbs().maxCoeff(), 5e-3F);
  EXPECT_LT((known * Eigen::Vector3f(from.col(7)) - known.apply(from).col(7)).norm(), 1e-3F);
}

TEST(Alignment, RigidKeepsTheScale) {
  const Eigen::Matrix3Xf from = cloud(50);
  const Similarity found = best_similarity(from, 2.0F * from, false);
  EXPECT_EQ(found.scale, 1);
  EXPECT_NEAR(found.rotation.determinant(), 1, 1e-5F);
}

TEST(Alignment, NeverMirrors) {
  const Eigen::Matrix3Xf from = cloud(50);
  Eigen::Matrix3Xf mirrored = from;
  mirrored.row(0) *= -1;
  EXPECT_NEAR(best_similarity(from, mirrored, true).rotation.determinant(), 1, 1e-5F);
}

TEST(Alignment, TooFewPointsGiveTheIdentity) {
  const Eigen::Matrix3Xf from = cloud(2);
  EXPECT_TRUE(best_similarity(from, 2.0F * from, true).rotation.isIdentity());
  EXPECT_EQ(best_similarity({}, {}, true).scale, 1);
}

}  // namespace
}  // namespace facet::maths
