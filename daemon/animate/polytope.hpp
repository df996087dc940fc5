#pragma once

#include <Eigen/Core>

namespace facet::animate {

/// The point nearest to another in a polytope: the dual active-set method for a quadratic program, which is
/// exact after some steps. One half-space after the other is met, the one most broken first; those that hold
/// the point meanwhile (three at most) are active, each with its multiplier.
/// directions [2 or 3][count] unit, edges [count]: inside is directions^T x <= edges, which must not be empty
Eigen::VectorXd nearest_inside(const Eigen::MatrixXd& directions, const Eigen::VectorXd& edges,
                               Eigen::VectorXd point);

}  // namespace facet::animate
