#include "fit/conjugate_gradients.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <limits>
#include <random>

namespace facet::fit {
namespace {

using Eigen::MatrixXf;
using Eigen::VectorXf;

constexpr Eigen::Index kSize = 13;
constexpr unsigned kSeed = 7;

/// Symmetric and positive definite, with a diagonal of several orders of magnitude.
MatrixXf definite() {
  std::mt19937 random(kSeed);
  std::normal_distribution<float> normal;
  const MatrixXf factor = MatrixXf::NullaryExpr(kSize, kSize, [&] { return normal(random); });
  const VectorXf scale = VectorXf::LinSpaced(kSize, -1.0F, 1.0F).array().exp();
  return scale.asDiagonal() *
         (factor * factor.transpose() / static_cast<float>(kSize) + MatrixXf::Identity(kSize, kSize)) *
         scale.asDiagonal();
}

GradientsOutcome solve(const MatrixXf& matrix, const VectorXf& gradient, int most_iterations,
                       VectorXf& step) {
  GradientsMemory<VectorXf> memory;
  step.resize(gradient.size());
  return conjugate_gradients(
      gradient, most_iterations, 1e-5F, [&](const VectorXf& in, VectorXf& out) { out = matrix * in; },
      [&](const VectorXf& in, VectorXf& out) { out = in.cwiseQuotient(matrix.diagonal()); }, memory, step);
}

TEST(ConjugateGradients, FindsTheStepOfAFactorisation) {
  const MatrixXf matrix = definite();
  const VectorXf gradient = VectorXf::LinSpaced(kSize, -2.0F, 3.0F);
  VectorXf step;
  EXPECT_EQ(solve(matrix, gradient, 100, step), GradientsOutcome::Converged);
  const VectorXf expected = -matrix.cast<double>().llt().solve(gradient.cast<double>()).cast<float>();
  EXPECT_LT((step - expected).norm(), 1e-3F * expected.norm()) << "seed " << kSeed;
}

TEST(ConjugateGradients, SaysThatTheIterationsRanOut) {
  const MatrixXf matrix = definite();
  const VectorXf gradient = VectorXf::Ones(kSize);
  VectorXf step;
  EXPECT_EQ(solve(matrix, gradient, 2, step), GradientsOutcome::NotConverged);
  EXPECT_LT(gradient.dot(step), 0) << "downhill all the same";
}

TEST(ConjugateGradients, NothingToDoHasConverged) {
  VectorXf step;
  EXPECT_EQ(solve(definite(), VectorXf::Zero(kSize), 10, step), GradientsOutcome::Converged);
  EXPECT_EQ(step, VectorXf::Zero(kSize));
}

TEST(ConjugateGradients, AnIndefiniteMatrixAndNumbersThatAreNoneAreFailures) {
  VectorXf step;
  MatrixXf saddle = MatrixXf::Identity(kSize, kSize);
  saddle(0, 1) = saddle(1, 0) = -3;
  EXPECT_EQ(solve(saddle, VectorXf::Ones(kSize), 10, step), GradientsOutcome::NumericalFailure);
  EXPECT_TRUE(step.allFinite());
  VectorXf broken = VectorXf::Ones(kSize);
  broken[5] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(solve(definite(), broken, 10, step), GradientsOutcome::NumericalFailure);
}

}  // namespace
}  // namespace facet::fit
