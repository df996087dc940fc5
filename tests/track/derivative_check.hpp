#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

namespace facet::test {

/// Largest difference between `gradient` and the central differences of energy_at(i, h) = E(x moved by h
/// along unknown i), relative to the size of the gradient.
template <typename EnergyAt>
double gradient_error(const Eigen::VectorXd& gradient, const EnergyAt& energy_at, double h = 1e-6) {
  double worst = 0;
  const double scale = std::max(gradient.cwiseAbs().maxCoeff(), 1e-9);
  for (int i = 0; i < static_cast<int>(gradient.size()); ++i) {
    const double numeric = (energy_at(i, h) - energy_at(i, -h)) / (2 * h);
    worst = std::max(worst, std::abs(numeric - gradient[i]) / scale);
  }
  return worst;
}

}  // namespace facet::test
