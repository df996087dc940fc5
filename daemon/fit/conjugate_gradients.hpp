#pragma once

#include <Eigen/Core>
#include <cmath>

namespace facet::fit {

/// How conjugate gradients ended.
enum class GradientsOutcome {
  Converged,
  NotConverged,      ///< the iterations ran out; the step is the best one found
  NumericalFailure,  ///< the matrix is not positive along a direction, or a number is not finite; the step is
                     ///< what was found before
};

/// Memory of conjugate_gradients, used again by every call.
template <typename Vector>
struct GradientsMemory {
  Vector residual, direction, product, preconditioned;
};

/// step = -H^-1 gradient by preconditioned conjugate gradients from 0, until the preconditioned residual has
/// shrunk by `reduction`.
///
/// apply(in, out)         out = H in, H symmetric and positive definite
/// precondition(in, out)  out = M^-1 in, M close to H
template <typename Vector, typename Apply, typename Precondition>
GradientsOutcome conjugate_gradients(const Vector& gradient, int most_iterations, float reduction,
                                     Apply&& apply, Precondition&& precondition,
                                     GradientsMemory<Vector>& memory, Vector& step) {
  auto& [residual, direction, product, preconditioned] = memory;
  product.resizeLike(gradient);
  preconditioned.resizeLike(gradient);
  const auto dot = [](const Vector& a, const Vector& b) {
    return a.cwiseProduct(b).template cast<double>().sum();
  };
  step.setZero();
  residual = -gradient;
  precondition(residual, preconditioned);
  direction = preconditioned;
  double energy = dot(residual, preconditioned);
  const double enough = energy * static_cast<double>(reduction) * static_cast<double>(reduction);
  for (int i = 0; i < most_iterations && energy > enough; ++i) {
    apply(direction, product);
    const double curvature = dot(direction, product);
    if (!(curvature > 0)) {
      return GradientsOutcome::NumericalFailure;
    }
    const auto length = static_cast<float>(energy / curvature);
    step += length * direction;
    residual -= length * product;
    precondition(residual, preconditioned);
    const double next = dot(residual, preconditioned);
    direction = preconditioned + static_cast<float>(next / energy) * direction;
    energy = next;
  }
  if (!std::isfinite(energy)) {
    return GradientsOutcome::NumericalFailure;
  }
  return energy > enough ? GradientsOutcome::NotConverged : GradientsOutcome::Converged;
}

}  // namespace facet::fit
