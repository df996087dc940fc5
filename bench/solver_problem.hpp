#pragma once

#include <cstdint>
#include <vector>

#include "mesh/mesh.hpp"
#include "support/displacement_solver.hpp"

namespace facet::bench {

/// A displacement problem [MD19 eq. 6] with known truth: a curved sheet of 160 mm with 4-8
/// connectivity, wrinkles and bumps of up to half a millimetre, spherical-harmonics light, known albedo and
/// image noise of 0.4 percent of full scale. The coarse level's displacements are the truth's bumps without
/// its wrinkles.
struct SolverProblem {
  mesh::OneRings rings;
  std::vector<float> spacing_mm;  ///< [vertex_count] mean distance to the ring
  refine::DisplacementProblem problem;
  refine::DisplacementOptions options;
  std::vector<float> truth_mm;  ///< [vertex_count]

  std::size_t vertex_count() const { return rings.on_boundary.size(); }
};

/// About vertex_count vertices (a square grid), the same for the same seed. The result points into itself.
void make_problem(std::size_t vertex_count, std::uint32_t seed, SolverProblem& out);

/// E(d) of [MD19 eq. 6] in double precision. displacements_mm [vertex_count]
double energy(const SolverProblem& problem, const std::vector<float>& displacements_mm);

/// Root mean square of the difference to the truth over inner vertices, mm.
double rms_error_mm(const SolverProblem& problem, const std::vector<float>& displacements_mm);

}  // namespace facet::bench
