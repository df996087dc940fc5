// The nearest point of what was captured, also where that is flat, a line or a single place.

#include "animate/polytope.hpp"

#include <gtest/gtest.h>

#include <random>

namespace facet::animate {
namespace {

TEST(Polytope, TheNearestPointHasAllOfItBehindIt) {
  constexpr Eigen::Index kPoints = 40;
  constexpr Eigen::Index kDirections = 256;
  for (unsigned seed = 1; seed <= 120; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal(0, 1);
    const auto draw = [&] { return normal(random); };
    const Eigen::Index dimension = 2 + seed % 2;
    const Eigen::MatrixXd directions =
        Eigen::MatrixXd::NullaryExpr(dimension, kDirections, draw).colwise().normalized();
    // Round, thin along one axis, flat, a line, a point.
    const double widths[5][3] = {{1, 1, 1}, {1, 1e-3, 1}, {1, 0, 1}, {1, 0, 0}, {0, 0, 0}};
    Eigen::MatrixXd points = Eigen::MatrixXd::NullaryExpr(dimension, kPoints, draw);
    for (Eigen::Index axis = 0; axis < dimension; ++axis) {
      points.row(axis) *= 5 * widths[seed / 2 % 5][axis];
    }
    const Eigen::VectorXd edges = (directions.transpose() * points).rowwise().maxCoeff();
    const Eigen::VectorXd target = 10 * Eigen::VectorXd::NullaryExpr(dimension, draw);
    const Eigen::VectorXd found = nearest_inside(directions, edges, target);
    EXPECT_LT((directions.transpose() * found - edges).maxCoeff(), 1e-5) << "inside; seed " << seed;
    const Eigen::VectorXd back = target - found;
    EXPECT_LT((back.transpose() * (points.colwise() - found)).maxCoeff(), 1e-4 * (1 + back.norm()))
        << "seed " << seed;
    const Eigen::VectorXd again = nearest_inside(directions, edges, points.col(3));
    EXPECT_LT((again - points.col(3)).norm(), 1e-9) << "what is inside stays; seed " << seed;
  }
}

}  // namespace
}  // namespace facet::animate
