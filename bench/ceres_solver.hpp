#pragma once

#include <vector>

#include "solver_problem.hpp"

namespace facet::bench {

/// What Ceres did.
struct CeresResult {
  std::vector<float> displacements_mm;  ///< [vertex_count]
  int steps = 0;                        ///< Gauss-Newton (Levenberg-Marquardt) steps taken
  double step_ms = 0;                   ///< mean of a step: residuals, Jacobian and linear solve
};

/// Minimises [MD19 eq. 6] with Ceres' CGNR and Jacobi preconditioner: one residual block for each data term
/// (three residuals, analytic Jacobian over the ring), each smoothness and each prior term.
///
/// steps           at most
/// pcg_iterations  of each step exactly; 0: as many as Ceres wants, and steps until it calls itself converged
CeresResult solve_with_ceres(const SolverProblem& problem, int steps, int pcg_iterations, int threads);

}  // namespace facet::bench
