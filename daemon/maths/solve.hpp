#pragma once

#include <Eigen/Core>

namespace facet::maths {

/// Solvers of any size, which the compiler makes here once: in every unit that names Eigen's it takes
/// seconds.

/// Solves matrix * x = right by L D L^T; matrix [n][n] symmetric, of which the lower half is read.
Eigen::VectorXd solve_symmetric(const Eigen::MatrixXd& matrix, const Eigen::VectorXd& right);
/// The same for every column of right [n][columns].
Eigen::MatrixXd solve_symmetric_columns(const Eigen::MatrixXd& matrix, const Eigen::MatrixXd& right);

struct SymmetricEigen {
  Eigen::VectorXd values;   ///< [n] rising
  Eigen::MatrixXd vectors;  ///< [n][n] of length 1, in their order
};

/// Of a symmetric matrix [n][n], of which the lower half is read.
SymmetricEigen symmetric_eigen(const Eigen::MatrixXd& matrix);

}  // namespace facet::maths
