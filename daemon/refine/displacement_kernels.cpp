#include "refine/displacement_kernels.hpp"

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
  return push;
}

}  // namespace

SolverScratch::SolverScratch(gpu::Context& context, std::uint32_t capacity, std::uint32_t group_capacity,
                             std::uint32_t energy_slots, int pcg_iterations)
    : slopes(context, capacity, gpu::TexelFormat::Rgba32f, "slopes"),
      bends(context, capacity, gpu::TexelFormat::Rg32f, "bends"),
      jacobian_rows(context, group_capacity, gpu::TexelFormat::Rgba16f, "jacobian_rows"),
      jacobian_columns(context, group_capacity, gpu::TexelFormat::Rgba16f, "jacobian_columns"),
      solver_states{DeviceArray(context, capacity, gpu::TexelFormat::Rgba32f, "solver_states 0"),
                    DeviceArray(context, capacity, gpu::TexelFormat::Rgba32f, "solver_states 1")},
      preconditioned(context, capacity + 1, gpu::TexelFormat::R32f, "preconditioned"),
      products{DeviceArray(context, capacity + 1, gpu::TexelFormat::Rgba32f, "products 0"),
               DeviceArray(context, capacity + 1, gpu::TexelFormat::Rgba32f, "products 1")},
      sums(context,
           static_cast<std::size_t>(2 * pcg_iterations + 1) *
               static_cast<std::size_t>(context.info().workgroup_count),
           gpu::TexelFormat::R32f, "sums"),
      energies(context, sizeof(float) * energy_slots * context.info().workgroup_count, gpu::Memory::Readback,
               "energies") {
  clear(context, {&preconditioned.buffer, &products[0].buffer, &products[1].buffer, &sums.buffer});
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
      direction_(context, shaders::refine::kernels(), "refine/direction"),
      update_(context, shaders::refine::kernels(), "refine/update") {}

void DisplacementKernels::record_energy(gpu::Batch& batch, const LevelTopology& topology,
                                        const LevelState& state, const SolverScratch& scratch,
                                        const gpu::Buffer& light, const DisplacementOptions& options,
                                        std::uint32_t slot) const {
  SolvePush push = push_of(topology, options);
  push.energy_slot = slot;
  batch.dispatch(linearise_,
                 {{"vertex_rings", topology.vertex_rings.view},
                  {"ring_indices", topology.ring_indices},
                  {"positions", state.positions.view},
                  {"normals", state.normals.view},
                  {"colours", state.colours.view},
                  {"albedo", state.albedo.view},
                  {"priors", state.priors.view},
                  {"light", light},
                  {"slopes", scratch.slopes.buffer},
                  {"bends", scratch.bends.buffer},
                  {"energies", scratch.energies}},
                 {topology.workgroup_count}, push);
}

void DisplacementKernels::record(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                                 const SolverScratch& scratch, const gpu::Buffer& light,
                                 const DisplacementOptions& options, std::uint32_t first_slot) const {
  const gpu::Groups groups{topology.workgroup_count};
  SolvePush push = push_of(topology, options);
  for (int step = 0; step < options.gauss_newton_steps; ++step) {
    record_energy(batch, topology, state, scratch, light, options,
                  first_slot + static_cast<std::uint32_t>(step));
    batch.dispatch(gradient_,
                   {{"vertex_rings", topology.vertex_rings.view},
                    {"ring_indices", topology.ring_indices},
                    {"positions", state.positions.view},
                    {"normals", state.normals.view},
                    {"slopes", scratch.slopes.view},
                    {"bends", scratch.bends.view},
                    {"priors", state.priors.view},
                    {"jacobian_rows", scratch.jacobian_rows.buffer},
                    {"jacobian_columns", scratch.jacobian_columns.buffer},
                    {"solver_states", scratch.solver_states[0].buffer},
                    {"preconditioned", scratch.preconditioned.buffer},
                    {"products", scratch.products[0].buffer},
                    {"sums", scratch.sums.buffer}},
                   groups, push);
    for (int iteration = 0; iteration < options.pcg_iterations; ++iteration) {
      push.iteration = static_cast<std::uint32_t>(iteration);
      push.last = iteration + 1 == options.pcg_iterations ? 1 : 0;
      // By turns: what a kernel reads as texels it does not write.
      const std::size_t from = static_cast<std::size_t>(iteration) % 2;
      const std::size_t to = 1 - from;
      batch.dispatch(direction_,
                     {{"vertex_rings", topology.vertex_rings.view},
                      {"ring_groups", topology.ring_groups.view},
                      {"bends", scratch.bends.view},
                      {"jacobian_rows", scratch.jacobian_rows.view},
                      {"preconditioned", scratch.preconditioned.view},
                      {"products_before", scratch.products[from].view},
                      {"products", scratch.products[to].buffer},
                      {"sums", scratch.sums.buffer}},
                     groups, push);
      batch.dispatch(update_,
                     {{"vertex_rings", topology.vertex_rings.view},
                      {"ring_groups", topology.ring_groups.view},
                      {"jacobian_columns", scratch.jacobian_columns.view},
                      {"products", scratch.products[to].view},
                      {"states_before", scratch.solver_states[from].view},
                      {"solver_states", scratch.solver_states[to].buffer},
                      {"preconditioned", scratch.preconditioned.buffer},
                      {"positions", state.positions.buffer},
                      {"sums", scratch.sums.buffer}},
                     groups, push);
    }
  }
}

}  // namespace facet::refine
