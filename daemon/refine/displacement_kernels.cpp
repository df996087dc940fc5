#include "refine/displacement_kernels.hpp"

#include <algorithm>

#include "refine_shaders.hpp"
#include "shaders/refine/layout.h"

namespace facet::refine {
namespace {

using shaders::refine::SolvePush;

SolvePush push_of(const LevelTopology& topology, const DisplacementOptions& options) {
  SolvePush push{};
  push.vertex_count = topology.vertex_count;
  push.smooth_weight = options.smooth_weight;
  push.hierarchy_weight = options.hierarchy_weight;
  push.coarse_weight = options.coarse_weight;
  push.robust_scale = options.robust_scale;
  push.bound_mm = options.bound_mm;
  push.fold_slope = options.fold_slope;
  push.pcg_iterations = static_cast<std::uint32_t>(options.pcg_iterations);
  return push;
}

}  // namespace

SolverScratch::SolverScratch(gpu::Context& context, std::uint32_t capacity, std::uint32_t group_capacity,
                             std::uint32_t places, std::uint32_t energy_slots)
    : slopes(context, capacity, gpu::TexelFormat::Rgba32f, "slopes"),
      bends(context, capacity, gpu::TexelFormat::Rg32f, "bends"),
      jacobian_rows(context, group_capacity, gpu::TexelFormat::Rgba16f, "jacobian_rows"),
      jacobian_columns(context, group_capacity, gpu::TexelFormat::Rgba16f, "jacobian_columns"),
      solver_starts(context, capacity, gpu::TexelFormat::Rgba32f, "solver_starts"),
      preconditioned(context, places, gpu::TexelFormat::R32f, "preconditioned"),
      products(context, places, gpu::TexelFormat::Rg32f, "products"),
      states(context, places, gpu::TexelFormat::Rgba32f, "states"),
      energies(context, sizeof(float) * energy_slots * context.info().workgroup_count, gpu::Memory::Readback,
               "energies") {
  clear(context, {&preconditioned.buffer, &products.buffer});
}

double SolverScratch::energy(std::uint32_t slot, std::uint32_t workgroup_count) const {
  const auto values = energies.mapped_as<float>();
  double sum = 0;
  for (std::uint32_t group = 0; group < workgroup_count; ++group) {
    sum += static_cast<double>(values[static_cast<std::size_t>(slot) * workgroup_count + group]);
  }
  return sum;
}

DisplacementKernels::DisplacementKernels(gpu::Context& context)
    : linearise_(context, shaders::refine::kernels(), "refine/linearise"),
      gradient_(context, shaders::refine::kernels(), "refine/gradient"),
      solve_patches_(context, shaders::refine::kernels(), "refine/solve_patches",
                     {{"local_size_x", context.info().patch_lanes},
                      {"kInSharedMemory", context.info().patch_places > 0},
                      {"kSharedPlaces", std::max(1U, context.info().patch_places)}}) {}

void DisplacementKernels::record_energy(gpu::Batch& batch, const LevelTopology& topology,
                                        const LevelState& state, const SolverScratch& scratch,
                                        const gpu::Buffer& light, const DisplacementOptions& options,
                                        std::uint32_t slot) const {
  SolvePush push = push_of(topology, options);
  push.energy_slot = slot;
  batch.dispatch(linearise_,
                 {{"vertex_rings", topology.vertex_rings.view},
                  {"ring_indices", topology.ring_indices.view},
                  {"positions", state.positions.view},
                  {"normals", state.normals.view},
                  {"colours", state.colours.view},
                  {"albedo", state.albedo.view},
                  {"irradiance", state.irradiance.view},
                  {"priors", state.priors.view},
                  {"reliefs", state.reliefs.view},
                  {"light", light},
                  {"slopes", scratch.slopes.buffer},
                  {"bends", scratch.bends.buffer},
                  {"energies", scratch.energies}},
                 {topology.workgroup_count}, push);
}

void DisplacementKernels::record(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                                 const SolverScratch& scratch, const gpu::Buffer& light,
                                 const DisplacementOptions& options, std::uint32_t first_slot) const {
  SolvePush push = push_of(topology, options);
  for (int step = 0; step < options.gauss_newton_steps; ++step) {
    record_energy(batch, topology, state, scratch, light, options,
                  first_slot + static_cast<std::uint32_t>(step));
    batch.dispatch(gradient_,
                   {{"vertex_rings", topology.vertex_rings.view},
                    {"ring_indices", topology.ring_indices.view},
                    {"positions", state.positions.view},
                    {"normals", state.normals.view},
                    {"slopes", scratch.slopes.view},
                    {"bends", scratch.bends.view},
                    {"priors", state.priors.view},
                    {"reliefs", state.reliefs.view},
                    {"jacobian_rows", scratch.jacobian_rows.buffer},
                    {"jacobian_columns", scratch.jacobian_columns.buffer},
                    {"solver_starts", scratch.solver_starts.buffer}},
                   {topology.workgroup_count}, push);
    const LevelPatches& patches = topology.patches;
    const PatchLists::Set& set = patches.set(step);
    push.first_patch = set.first;
    push.first_record = set.first_record;
    batch.dispatch(solve_patches_,
                   {{"patches", patches.patches.view},
                    {"patch_vertices", patches.vertices.view},
                    {"patch_groups", patches.groups.view},
                    {"solver_starts", scratch.solver_starts.view},
                    {"jacobian_rows", scratch.jacobian_rows.view},
                    {"jacobian_columns", scratch.jacobian_columns.view},
                    {"preconditioned", scratch.preconditioned.view},
                    {"products", scratch.products.view},
                    {"states", scratch.states.view},
                    {"positions", state.positions.buffer}},
                   {set.count}, push);
  }
}

}  // namespace facet::refine
