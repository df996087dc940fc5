#pragma once

#include <cstdint>

#include "gpu/batch.hpp"
#include "refine/level_buffers.hpp"

namespace facet::refine {

/// How the displacements of one level are solved [MD19 eq. 6-8].
///
/// Residuals are relative to the face's rms brightness, so the weights hold for any exposure. The smoothness
/// and hierarchy terms are slopes: L d and pd - d divided by the vertex spacing, both in mm, so they hold for
/// any level and image size. The coarse term counts mm.
struct DisplacementOptions {
  float smooth_weight = 0;     ///< w3
  float hierarchy_weight = 0;  ///< w4; pass 0 at the coarsest refined level
  float coarse_weight = 0;     ///< w5, per mm^2
  float robust_scale = 0;      ///< Tukey's bound on relative residuals; 0: plain squares
  float fold_slope = 0;        ///< bend at which w3 begins to spare a fold; 0: plain squares
  float bound_mm = 6;          ///< displacements are held within +- this
  int gauss_newton_steps = 2;
  int pcg_iterations = 7;
};

/// What the solver writes between its kernels; shared by all levels.
struct SolverScratch {
  /// capacity        vertices of the largest level
  /// group_capacity  ring groups of the largest level
  /// places          LevelPatches::place_count of the largest
  SolverScratch(gpu::Context& context, std::uint32_t capacity, std::uint32_t group_capacity,
                std::uint32_t places, std::uint32_t energy_slots);

  /// The energy before step `slot`, summed over the workgroups that ran.
  double energy(std::uint32_t slot, std::uint32_t workgroup_count) const;

  DeviceArray slopes;
  DeviceArray bends;
  DeviceArray jacobian_rows;
  DeviceArray jacobian_columns;
  DeviceArray solver_starts;
  DeviceArray preconditioned;  ///< [place], as the two below
  DeviceArray products;
  DeviceArray states;
  gpu::Buffer energies;  ///< [slot][workgroup], for the host
};

/// The kernels of the displacement solve: three a Gauss-Newton step.
class DisplacementKernels {
 public:
  explicit DisplacementKernels(gpu::Context& context);

  /// Records the Gauss-Newton steps of one level. Its state must hold positions with start displacements,
  /// normals, colours, albedo and priors; the displacements in positions.w are moved.
  /// light       a shaders::refine::Light
  /// first_slot  of scratch.energies: step k writes the energy it starts from to slot first_slot + k
  void record(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
              const SolverScratch& scratch, const gpu::Buffer& light, const DisplacementOptions& options,
              std::uint32_t first_slot) const;

  /// Records the evaluation of the energy alone, to slot `slot`.
  void record_energy(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                     const SolverScratch& scratch, const gpu::Buffer& light,
                     const DisplacementOptions& options, std::uint32_t slot) const;

 private:
  gpu::Kernel linearise_;
  gpu::Kernel gradient_;
  gpu::Kernel solve_patches_;
};

}  // namespace facet::refine
