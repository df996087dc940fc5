#include "animate/polytope.hpp"

#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "maths/solve.hpp"

namespace facet::animate {

Eigen::VectorXd nearest_inside(const Eigen::MatrixXd& directions, const Eigen::VectorXd& edges,
                               Eigen::VectorXd point) {
  constexpr int kMostSteps = 500;
  constexpr double kInside = 1e-6;  // mm or px
  constexpr double kParallel = 1e-9;
  std::vector<Eigen::Index> active;
  std::vector<double> multipliers;
  for (int step = 0; step < kMostSteps; ++step) {
    Eigen::Index added = 0;
    if ((directions.transpose() * point - edges).maxCoeff(&added) <= kInside) {
      break;
    }
    const Eigen::VectorXd normal = directions.col(added);
    double multiplier = 0;
    for (bool met = false; !met && step < kMostSteps; ++step) {
      const Eigen::MatrixXd held = directions(Eigen::all, active);
      const Eigen::VectorXd share =
          active.empty() ? Eigen::VectorXd()
                         : maths::solve_symmetric(held.transpose() * held, held.transpose() * normal);
      const Eigen::VectorXd way = active.empty() ? normal : Eigen::VectorXd(normal - held * share);
      // As far as the half-space asks for, or until an active one lets go.
      const double slope = way.dot(normal);
      double length = slope > kParallel ? (normal.dot(point) - edges[added]) / slope
                                        : std::numeric_limits<double>::infinity();
      met = true;
      std::size_t let_go = 0;
      for (std::size_t k = 0; k < active.size(); ++k) {
        const double most = multipliers[k] / share[static_cast<Eigen::Index>(k)];
        if (share[static_cast<Eigen::Index>(k)] > 0 && most < length) {
          length = most;
          let_go = k;
          met = false;
        }
      }
      if (!std::isfinite(length)) {
        return point;  // rounding alone leaves no room
      }
      point -= length * way;
      multiplier += length;
      for (std::size_t k = 0; k < active.size(); ++k) {
        multipliers[k] -= length * share[static_cast<Eigen::Index>(k)];
      }
      if (!met) {
        active.erase(active.begin() + static_cast<std::ptrdiff_t>(let_go));
        multipliers.erase(multipliers.begin() + static_cast<std::ptrdiff_t>(let_go));
      }
    }
    active.push_back(added);
    multipliers.push_back(multiplier);
  }
  return point;
}

}  // namespace facet::animate
