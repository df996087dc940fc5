#include "track/expression_prior.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "derivative_check.hpp"

namespace facet::track {
namespace {

const std::vector<std::string> kNames = {
    "jawOpen",      "mouthClose",    "mouthSmileLeft",  "mouthSmileRight",  "mouthFrownLeft", "browInnerUp",
    "browDownLeft", "browDownRight", "browOuterUpLeft", "browOuterUpRight", "jawLeft",        "jawRight"};
const std::vector<float> kSigma(kNames.size(), 0.3F);

Eigen::VectorXd expression_with(const std::string& name, double weight) {
  Eigen::VectorXd expression = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(kNames.size()));
  expression[std::find(kNames.begin(), kNames.end(), name) - kNames.begin()] = weight;
  return expression;
}

TEST(ExpressionPrior, GradientMatchesDifferences) {
  const ExpressionPrior prior(kNames, kSigma, {}, false);
  std::mt19937 random(3);
  std::uniform_real_distribution<double> weight(0.05, 0.95);
  const auto count = static_cast<int>(kNames.size());
  for (int round = 0; round < 10; ++round) {
    const Eigen::VectorXd expression = Eigen::VectorXd::NullaryExpr(count, [&] { return weight(random); });
    Eigen::MatrixXd hessian = Eigen::MatrixXd::Zero(count + 2, count + 2);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(count + 2);
    prior.add(expression, 2, hessian, gradient);
    EXPECT_EQ(gradient.head(2).norm(), 0.0);
    EXPECT_LT((hessian - hessian.transpose()).norm(), 1e-12);
    const auto energy_at = [&](int i, double h) {
      return prior.energy(expression + h * Eigen::VectorXd::Unit(count, i));
    };
    EXPECT_LT(test::gradient_error(gradient.tail(count), energy_at), 1e-7);
  }
}

TEST(ExpressionPrior, ShapesThatUndoEachOtherCostMoreTogether) {
  const ExpressionPrior prior(kNames, kSigma, {}, false);
  const auto together = [&](const std::string& a, const std::string& b) {
    return prior.energy(expression_with(a, 0.5) + expression_with(b, 0.5)) -
           prior.energy(expression_with(a, 0.5)) - prior.energy(expression_with(b, 0.5));
  };
  EXPECT_GT(together("mouthSmileLeft", "mouthFrownLeft"), 1.0);
  EXPECT_GT(together("browInnerUp", "browDownLeft"), 1.0);
  EXPECT_GT(together("jawLeft", "jawRight"), 1.0);
  EXPECT_LT(together("mouthSmileLeft", "mouthSmileRight"), 0.0)
      << "a symmetric smile is cheaper than two halves";
  EXPECT_LT(together("mouthClose", "jawOpen"), 0.0)
      << "closing the mouth is cheap only while the jaw is open";
  EXPECT_NEAR(together("jawOpen", "browInnerUp"), 0.0, 1e-9);
}

TEST(ExpressionPrior, EyesTurnTogetherWhereTheGazeIsSeen) {
  const std::vector<std::string> names = {"eyeLookInLeft", "eyeLookOutLeft", "eyeLookInRight",
                                          "eyeLookOutRight"};
  const std::vector<float> sigma(4, 0.3F);
  const ExpressionPrior unseen(names, sigma, {}, false);
  const ExpressionPrior seen(names, sigma, {}, true);
  const Eigen::Vector4d to_the_left(0, 0.4, 0.4, 0);
  EXPECT_LT(seen.energy(to_the_left), 0.1 * unseen.energy(to_the_left));
  EXPECT_LT(seen.energy(to_the_left), seen.energy(Eigen::Vector4d(0.4, 0, 0.4, 0))) << "a squint costs more";
  EXPECT_GT(seen.energy(Eigen::Vector4d(0.4, 0.4, 0, 0)), seen.energy(Eigen::Vector4d(0.4, 0, 0, 0.4)))
      << "nobody looks both ways with one eye";
}

TEST(ExpressionPrior, ForeignNamesHaveNoPairs) {
  const std::vector<std::string> names = {"AU1", "AU2", "smile"};
  const std::vector<float> sigma = {0.3F, 0.0F, 0.3F};
  const ExpressionPrior prior(names, sigma, {}, false);
  EXPECT_GT(prior.sigma()[1], 0.0) << "a sigma of 0 would divide by 0";
  EXPECT_TRUE(std::isfinite(prior.energy(Eigen::Vector3d(0.2, 0.3, 0.4))));
}

}  // namespace
}  // namespace facet::track
