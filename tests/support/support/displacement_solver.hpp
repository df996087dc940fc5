#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "gpu/context.hpp"
#include "mesh/mesh.hpp"
#include "refine/displacement_kernels.hpp"

namespace facet::refine {

/// The displacement problem of one level, [MD19 eq. 6], as numbers on the host. Vectors stand in
/// the shading frame: x right, y up, z towards the camera.
struct DisplacementProblem {
  const mesh::OneRings* one_rings = nullptr;
  mesh::Vertices vertices_mm;       ///< [3][vertex_count] coarse mesh of this level
  Eigen::Matrix3Xf normals;         ///< [3][vertex_count] unit coarse normals
  Eigen::Matrix3Xf colours;         ///< [3][vertex_count] I, linear RGB
  std::vector<float> data_weight;   ///< [vertex_count] of the vertex's data residuals; 0 where unseen
  Eigen::Matrix3Xf albedo;          ///< [3][vertex_count] rho, linear RGB
  Eigen::Matrix4Xf irradiance;      ///< [4][vertex_count] of the room's lamps (RoomLight); empty: none
  std::vector<std::uint8_t> fixed;  ///< [vertex_count] 1: d = 0; boundary vertices are fixed anyway, and
                                    ///< carry no data
  std::array<float, 9> lighting{};
  float gain = 1;                    ///< residuals are squared times this: 1 / mean square brightness
  std::vector<float> prolonged_mm;   ///< [vertex_count] pd
  std::vector<float> start_mm;       ///< [vertex_count]
  std::uint32_t patch_vertices = 0;  ///< of a patch at most; 0: as the device wants it
};

enum class DisplacementOutcome { Converged, NumericalFailure, DeviceLost };

struct DisplacementResult {
  DisplacementOutcome outcome = DisplacementOutcome::Converged;
  std::string failure;                  ///< for people, empty where all is well
  std::vector<float> displacements_mm;  ///< [vertex_count]
  std::vector<double> energies;         ///< [gauss_newton_steps + 1] E before each step and after the last
  float solve_ms = 0;                   ///< on the device, all steps
};

/// Solves one level's displacements on its own: for benchmarks and tests. The refiner runs the same kernels.
class DisplacementSolver {
 public:
  /// Compiles the kernels. Throws Error(NoDevice). The context must outlive the solver.
  explicit DisplacementSolver(gpu::Context& context);
  ~DisplacementSolver();

  /// Uploads the problem and records its steps. Throws Error(Usage) where an array has the wrong length.
  void load(const DisplacementProblem& problem, const DisplacementOptions& options);

  /// Runs the steps from the problem's start values; may be called again and again. One thread.
  DisplacementResult solve();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::refine
