#include "maths/solve.hpp"

#include <gtest/gtest.h>

#include <random>

namespace facet::maths {
namespace {

/// Symmetric and positive definite. Seeded by its size.
Eigen::MatrixXd some_normal_matrix(Eigen::Index size) {
  std::mt19937 random(static_cast<unsigned>(size));
  std::normal_distribution<double> number;
  const Eigen::MatrixXd rows = Eigen::MatrixXd::NullaryExpr(size + 2, size, [&] { return number(random); });
  return rows.transpose() * rows;
}

TEST(Solve, SolutionsFulfilTheirEquations) {
  for (const Eigen::Index size : {1, 2, 13, 48}) {
    const Eigen::MatrixXd matrix = some_normal_matrix(size);
    const Eigen::MatrixXd wanted = some_normal_matrix(size + 1).topLeftCorner(size, size);
    const Eigen::MatrixXd columns = solve_symmetric_columns(matrix, matrix * wanted);
    EXPECT_LT((columns - wanted).norm(), 1e-7 * wanted.norm()) << size;
    const Eigen::VectorXd one = solve_symmetric(matrix, matrix * wanted.col(0));
    EXPECT_LT((one - wanted.col(0)).norm(), 1e-7 * wanted.norm()) << size;
  }
}

TEST(Solve, OnlyTheLowerHalfIsRead) {
  Eigen::MatrixXd matrix = some_normal_matrix(5);
  const Eigen::VectorXd right = Eigen::VectorXd::LinSpaced(5, -1, 3);
  const Eigen::VectorXd whole = solve_symmetric(matrix, right);
  const SymmetricEigen eigen = symmetric_eigen(matrix);
  matrix.triangularView<Eigen::StrictlyUpper>().setConstant(99);
  EXPECT_EQ(solve_symmetric(matrix, right), whole);
  EXPECT_EQ(symmetric_eigen(matrix).values, eigen.values);
}

TEST(Solve, EigenvaluesRiseAndMakeTheMatrix) {
  const Eigen::MatrixXd matrix = some_normal_matrix(13);
  const SymmetricEigen eigen = symmetric_eigen(matrix);
  for (Eigen::Index i = 1; i < 13; ++i) {
    EXPECT_LE(eigen.values[i - 1], eigen.values[i]);
  }
  EXPECT_LT((eigen.vectors.transpose() * eigen.vectors - Eigen::MatrixXd::Identity(13, 13)).norm(), 1e-12);
  EXPECT_LT((eigen.vectors * eigen.values.asDiagonal() * eigen.vectors.transpose() - matrix).norm(),
            1e-12 * matrix.norm());
}

}  // namespace
}  // namespace facet::maths
