#include "track/camera_pose.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <random>

#include "track/normal_equations.hpp"

namespace facet::track {
namespace {

Eigen::Vector3d random_vector(std::mt19937& random, double size) {
  std::uniform_real_distribution<double> unit(-size, size);
  return {unit(random), unit(random), unit(random)};
}

TEST(CameraPose, RotationAndVectorAreInverse) {
  std::mt19937 random(7);
  for (const double size : {1e-9, 1e-5, 0.1, 1.0, 1.8}) {
    const Eigen::Vector3d omega = random_vector(random, size);
    const Eigen::Matrix3d rotation = rotation_from_vector(omega);
    EXPECT_LT((rotation * rotation.transpose() - Eigen::Matrix3d::Identity()).norm(), 1e-12);
    EXPECT_LT((rotation - Eigen::AngleAxisd(omega.norm(), omega.normalized()).toRotationMatrix()).norm(),
              1e-12);
    EXPECT_LT((vector_from_rotation(rotation) - omega).norm(), 1e-9) << size;
  }
  const double nearly_half_turn = std::numbers::pi - 1e-6;
  const Eigen::Vector3d omega = nearly_half_turn * Eigen::Vector3d(1, 2, -2).normalized();
  EXPECT_LT((vector_from_rotation(rotation_from_vector(omega)) - omega).norm(), 1e-6);
}

TEST(CameraPose, LeftJacobianInverseMatchesDifferences) {
  std::mt19937 random(8);
  for (const double size : {1e-6, 1e-3, 0.3, 1.5}) {
    const Eigen::Vector3d omega = random_vector(random, size);
    const Eigen::Matrix3d rotation = rotation_from_vector(omega);
    const Eigen::Matrix3d jacobian = left_jacobian_inverse(omega);
    constexpr double h = 1e-6;
    for (int i = 0; i < 3; ++i) {
      const Eigen::Vector3d d = h * Eigen::Vector3d::Unit(i);
      const Eigen::Vector3d numeric = (vector_from_rotation(rotation_from_vector(d) * rotation) -
                                       vector_from_rotation(rotation_from_vector(-d) * rotation)) /
                                      (2 * h);
      EXPECT_LT((numeric - jacobian.col(i)).norm(), 1e-6) << "size " << size << " axis " << i;
    }
  }
}

TEST(CameraPose, ProjectionDerivativesMatchDifferences) {
  const Eigen::Vector3d point(40, -70, 480);
  const Eigen::Vector2d centre(639.5, 359.5);
  Projection at;
  ASSERT_TRUE(project(point, 900, centre, at));
  constexpr double h = 1e-4;
  for (int i = 0; i < 3; ++i) {
    Projection plus, minus;
    ASSERT_TRUE(project(point + h * Eigen::Vector3d::Unit(i), 900, centre, plus));
    ASSERT_TRUE(project(point - h * Eigen::Vector3d::Unit(i), 900, centre, minus));
    EXPECT_LT(((plus.px - minus.px) / (2 * h) - at.by_point.col(i)).norm(), 1e-7);
  }
  Projection plus, minus;
  ASSERT_TRUE(project(point, 900 * std::exp(h), centre, plus));
  ASSERT_TRUE(project(point, 900 * std::exp(-h), centre, minus));
  EXPECT_LT(((plus.px - minus.px) / (2 * h) - at.by_log_focal).norm(), 1e-5);
}

TEST(CameraPose, NothingIsProjectedFromBehind) {
  Projection at;
  for (const double z : {19.0, 0.0, -500.0, std::nan("")}) {
    EXPECT_FALSE(project(Eigen::Vector3d(1, 2, z), 900, Eigen::Vector2d(0, 0), at)) << z;
  }
}

TEST(CameraPose, SimilarityFindsAWeakPerspectivePose) {
  std::mt19937 random(9);
  Eigen::Matrix3Xd head(3, 50);
  for (int i = 0; i < 50; ++i) {
    head.col(i) = random_vector(random, 80);
  }
  const Eigen::Matrix3d rotation = rotation_from_vector(Eigen::Vector3d(0.2, -0.6, 0.3)) * Pose().rotation;
  const double px_per_mm = 1.6;
  Eigen::Matrix3Xd px = px_per_mm * (rotation * head);
  px.row(0).array() += 700;
  px.row(1).array() += 300;
  const auto pose =
      pose_from_similarity(head, px, Eigen::VectorXd::Ones(50), 900, Eigen::Vector2d(639.5, 359.5));
  ASSERT_TRUE(pose.has_value());
  EXPECT_LT((pose->rotation - rotation).norm(), 1e-9);
  // The scale is that of the points' mean.
  const Eigen::Vector3d mean = pose->rotation * head.rowwise().mean() + pose->translation_mm;
  EXPECT_NEAR(mean.z(), 900 / px_per_mm, 1e-6);
  EXPECT_NEAR(mean.x(), (px.row(0).mean() - 639.5) / px_per_mm, 1e-6);
  EXPECT_NEAR(mean.y(), (px.row(1).mean() - 359.5) / px_per_mm, 1e-6);
}

TEST(CameraPose, SimilarityRefusesDegeneratePoints) {
  std::mt19937 random(10);
  Eigen::Matrix3Xd head(3, 50);
  for (int i = 0; i < 50; ++i) {
    head.col(i) = random_vector(random, 80);
  }
  const Eigen::VectorXd ones = Eigen::VectorXd::Ones(50);
  const Eigen::Vector2d centre(0, 0);
  const Eigen::Matrix3Xd equal = Eigen::Vector3d(10, 20, 0).replicate(1, 50);
  EXPECT_FALSE(pose_from_similarity(head, equal, ones, 900, centre).has_value());
  const Eigen::Matrix3Xd line = Eigen::Vector3d(1, 2, 3) * Eigen::RowVectorXd::LinSpaced(50, 0, 100);
  EXPECT_FALSE(pose_from_similarity(head, line, ones, 900, centre).has_value());
  Eigen::Matrix3Xd poisoned = head;
  poisoned(0, 3) = std::nan("");
  EXPECT_FALSE(pose_from_similarity(head, poisoned, ones, 900, centre).has_value());
  EXPECT_FALSE(pose_from_similarity(head, head, 0 * ones, 900, centre).has_value());
}

TEST(CameraPose, SimilarityOfMirroredPointsIsStillARotation) {
  std::mt19937 random(11);
  Eigen::Matrix3Xd head(3, 50);
  for (int i = 0; i < 50; ++i) {
    head.col(i) = random_vector(random, 80);
  }
  Eigen::Matrix3Xd px = Pose().rotation * head;
  px.row(0) *= -1;
  const auto pose = pose_from_similarity(head, px, Eigen::VectorXd::Ones(50), 900, Eigen::Vector2d(0, 0));
  ASSERT_TRUE(pose.has_value());
  EXPECT_NEAR(pose->rotation.determinant(), 1.0, 1e-9);
}

TEST(NormalEquations, EqualTheProductsOfTheWholeMatrix) {
  std::mt19937 random(12);
  std::normal_distribution<double> normal;
  for (const int unknowns : {1, 13, 57, 64}) {
    for (const int rows : {1, 8, 127}) {
      NormalEquations equations(unknowns);
      const Eigen::MatrixXd jacobian =
          Eigen::MatrixXd::NullaryExpr(rows, unknowns, [&] { return normal(random); });
      const Eigen::VectorXd residuals = Eigen::VectorXd::NullaryExpr(rows, [&] { return normal(random); });
      for (int pass = 0; pass < 2; ++pass) {  // the second pass shows that clear forgets
        equations.clear();
        for (int r = 0; r < rows; ++r) {
          Eigen::Map<Eigen::RowVectorXd>(equations.add_row(residuals[r]), unknowns) = jacobian.row(r);
        }
        equations.finish();
        EXPECT_LT((equations.hessian - jacobian.transpose() * jacobian).norm(), 1e-10 * rows);
        EXPECT_LT((equations.gradient - jacobian.transpose() * residuals).norm(), 1e-10 * rows);
      }
    }
  }
}

TEST(NormalEquations, HeldUnknownsStayAndTheOthersSolveTheReducedSystem) {
  std::mt19937 random(13);
  std::normal_distribution<double> normal;
  const Eigen::MatrixXd root = Eigen::MatrixXd::NullaryExpr(9, 5, [&] { return normal(random); });
  const Eigen::MatrixXd hessian = root.transpose() * root;
  const Eigen::VectorXd gradient = Eigen::VectorXd::NullaryExpr(5, [&] { return normal(random); });
  BoundedStepScratch scratch(5);
  scratch.held[1] = 1;
  Eigen::VectorXd step(5);
  ASSERT_TRUE(solve_bounded_step(hessian, gradient, 0.0, scratch, step));
  EXPECT_EQ(step[1], 0.0);
  const Eigen::VectorXd left = hessian * step + gradient;
  for (const int i : {0, 2, 3, 4}) {
    EXPECT_NEAR(left[i], 0.0, 1e-6);
  }
  EXPECT_FALSE(solve_bounded_step(-hessian, gradient, 0.0, scratch, step));
}

}  // namespace
}  // namespace facet::track
