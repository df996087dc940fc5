#include "reference.hpp"

#include <gtest/gtest.h>

#include <random>

#include "problems.hpp"
#include "support/synthetic_face.hpp"

namespace facet::refine::reference {
namespace {

TEST(RefineReference, JacobianAgreesWithCentralDifferences) {
  const test::SmallProblem small = test::make_problem(7, 8, 11);
  const Problem& problem = small.problem;
  const auto weights = step_weights(problem, small.start_mm);
  const DerivativeCheck check =
      check_jacobian(problem, small.start_mm, jacobian(problem, small.start_mm, weights));
  // Central differences with a step of 1e-5 mm: truncation 1e-10, rounding 1e-16 / 1e-5.
  EXPECT_LT(check.worst_error, 1e-8) << check.where;
}

TEST(RefineReference, DerivativeCheckerFindsAWrongEntry) {
  const test::SmallProblem small = test::make_problem(7, 8, 11);
  const auto weights = step_weights(small.problem, small.start_mm);
  Eigen::SparseMatrix<double> wrong = jacobian(small.problem, small.start_mm, weights);
  Eigen::Index vertex = 0;
  while (small.problem.fixed[static_cast<std::size_t>(vertex)] != 0) {
    ++vertex;
  }
  Eigen::SparseMatrix<double>::InnerIterator entry(wrong, vertex);
  entry.valueRef() += 0.01 * wrong.coeffs().abs().maxCoeff();
  const DerivativeCheck check = check_jacobian(small.problem, small.start_mm, wrong);
  EXPECT_GT(check.worst_error, 5e-3);
  EXPECT_NE(check.where.find("vertex " + std::to_string(vertex)), std::string::npos) << check.where;
}

TEST(RefineReference, NormalMatrixIsSymmetric) {
  const test::SmallProblem small = test::make_problem(6, 5, 3);
  const auto weights = step_weights(small.problem, small.start_mm);
  const Eigen::SparseMatrix<double> j = jacobian(small.problem, small.start_mm, weights);
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  Eigen::VectorXd p(j.cols());
  Eigen::VectorXd q(j.cols());
  for (Eigen::Index i = 0; i < p.size(); ++i) {
    p[i] = normal(random);
    q[i] = normal(random);
  }
  const double pq = p.dot(j.transpose() * (j * q));
  EXPECT_NEAR(pq, q.dot(j.transpose() * (j * p)), 1e-12 * std::abs(pq));
}

TEST(RefineReference, PcgReachesTheExactStep) {
  const test::SmallProblem small = test::make_problem(6, 7, 17);
  const Eigen::VectorXd exact = gauss_newton_step(small.problem, small.start_mm, 0);
  const Eigen::VectorXd iterated = gauss_newton_step(small.problem, small.start_mm, 400);
  EXPECT_LT((exact - iterated).norm(), 1e-8 * exact.norm());
}

TEST(RefineReference, GaussNewtonLowersTheEnergyToAStationaryPoint) {
  test::SmallProblem small = test::make_problem(9, 8, 23);
  small.problem.robust_scale = 0;
  Eigen::VectorXd d = 4 * small.start_mm;
  const double before = energy(small.problem, d);
  for (int step = 0; step < 25; ++step) {
    d = gauss_newton_step(small.problem, d, 0);
  }
  EXPECT_LT(energy(small.problem, d), 0.5 * before);
  const auto weights = step_weights(small.problem, d);
  const Eigen::VectorXd gradient =
      jacobian(small.problem, d, weights).transpose() * residuals(small.problem, d, weights);
  EXPECT_LT(gradient.norm(), 1e-6);
  for (Eigen::Index i = 0; i < d.size(); ++i) {
    if (small.problem.fixed[static_cast<std::size_t>(i)] != 0) {
      EXPECT_EQ(d[i], 0);
    }
  }
}

TEST(RefineReference, FoldWeightIsTheSlopeOfItsLoss) {
  constexpr double kStep = 1e-6;
  for (const double bend : {0.001, 0.02, 0.3}) {
    const double slope = (fold_loss(bend + kStep, 0.02) - fold_loss(bend - kStep, 0.02)) / (2 * kStep);
    EXPECT_NEAR(2 * bend * fold_weight(bend, 0.02), slope, 1e-8);
  }
}

TEST(RefineReference, EnergyIsTheSumOfSquaredResiduals) {
  test::SmallProblem small = test::make_problem(5, 6, 29);
  small.problem.robust_scale = 0;
  small.problem.fold_slope = 0;
  const auto weights = step_weights(small.problem, small.start_mm);
  const double expected = residuals(small.problem, small.start_mm, weights).squaredNorm();
  EXPECT_NEAR(energy(small.problem, small.start_mm), expected, 1e-12 * expected);
}

TEST(RefineReference, LightingRecoversTheTruth) {
  const synthetic::Scene scene;
  Eigen::Matrix3Xd normals(3, 600);
  Eigen::Matrix3Xd albedo(3, 600);
  Eigen::Matrix3Xd colours(3, 600);
  std::mt19937 random(31);
  std::normal_distribution<double> normal;
  Lighting truth;
  for (int k = 0; k < 9; ++k) {
    truth[k] = static_cast<double>(scene.lighting[static_cast<std::size_t>(k)]);
  }
  for (Eigen::Index i = 0; i < normals.cols(); ++i) {
    normals.col(i) = Eigen::Vector3d(normal(random), normal(random), std::abs(normal(random))).normalized();
    albedo.col(i) =
        Eigen::Vector3d(0.5, 0.4, 0.3) + 0.05 * Eigen::Vector3d(normal(random), normal(random), 0);
    colours.col(i) = reflected(truth, normals.col(i), albedo.col(i));
  }
  Eigen::VectorXd lamps(600);
  for (Eigen::Index i = 0; i < lamps.size(); ++i) {
    lamps[i] = 0.3 + 0.1 * normal(random);
    colours.col(i) += lamps[i] * albedo.col(i);
  }
  RoomLighting wanted;
  wanted << truth, 1;
  const Eigen::VectorXd ones = Eigen::VectorXd::Ones(600);
  const RoomLighting found =
      estimate_lighting(normals, lamps, albedo, colours, ones, 1e-9, RoomLighting::Zero());
  EXPECT_LT((found - wanted).norm(), 1e-6);
  const RoomLighting held = estimate_lighting(normals, lamps, albedo, colours, ones, 1e9, 2 * wanted);
  EXPECT_LT((held - 2 * wanted).norm(), 1e-4);
}

TEST(RefineReference, AlbedoFollowsTheDataOrThePrior) {
  const test::SmallProblem small = test::make_problem(6, 6, 37);
  const Eigen::Index count = small.problem.vertex_count();
  const Eigen::Matrix3Xd truth = small.problem.albedo;
  const Eigen::Matrix3Xd mean = Eigen::Vector3d(0.5, 0.4, 0.3).replicate(1, count);
  const Eigen::VectorXd shade_squared = Eigen::VectorXd::Constant(count, 2.0);
  const Eigen::Matrix3Xd shade_colour = 2.0 * truth;
  const Eigen::Matrix3Xd followed =
      estimate_albedo(*small.problem.rings, shade_squared, shade_colour, mean, 0);
  EXPECT_LT((followed - truth).norm(), 1e-12);
  const Eigen::Matrix3Xd smooth =
      estimate_albedo(*small.problem.rings, shade_squared, shade_colour, mean, 1e9);
  // Only the overall colour is left to the data; the shape is the mean's: constant.
  EXPECT_LT((smooth.colwise() - smooth.col(0)).norm(), 1e-5);
}

TEST(RefineReference, TukeyLossFitsItsWeight) {
  // weight = d loss / d (r^2), by central differences in r^2
  for (const double r : {0.02, 0.1, 0.19}) {
    constexpr double kScale = 0.2;
    constexpr double kStep = 1e-7;
    const double slope =
        (tukey_loss(std::sqrt(r * r + kStep), kScale) - tukey_loss(std::sqrt(r * r - kStep), kScale)) /
        (2 * kStep);
    EXPECT_NEAR(tukey_weight(r, kScale), slope, 1e-6);
  }
  EXPECT_EQ(tukey_weight(0.3, 0.2), 0);
  EXPECT_EQ(tukey_weight(0.3, 0), 1);
}

}  // namespace
}  // namespace facet::refine::reference
