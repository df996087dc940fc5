#include "refine/albedo.hpp"

#include "refine_shaders.hpp"
#include "shaders/refine/layout.h"

namespace facet::refine {

AlbedoState::AlbedoState(gpu::Context& context, std::uint32_t vertex_count, int pcg_iterations)
    : mean(context, vertex_count, gpu::TexelFormat::Rgba32f, "mean_albedo"),
      sums(context, vertex_count, gpu::TexelFormat::Rgba32f, "albedo_sums"),
      counts(context, vertex_count, gpu::TexelFormat::R32f, "albedo_counts"),
      gained(context, sizeof(float) * context.info().workgroup_count, gpu::Memory::Readback, "albedo_gained"),
      deviations(context, vertex_count, gpu::TexelFormat::Rgba32f, "deviations"),
      tints(context, 2 * sizeof(shaders::vec4) * context.info().workgroup_count, gpu::Memory::Device,
            "albedo_tints"),
      tint(context, sizeof(shaders::vec4), gpu::Memory::Device, "albedo_tint"),
      bends(context, vertex_count, gpu::TexelFormat::Rgba32f, "albedo_bends"),
      units(context, sizeof(shaders::vec2) * context.info().workgroup_count, gpu::Memory::Device,
            "albedo_units"),
      luminances(context, sizeof(shaders::vec2) * context.info().workgroup_count, gpu::Memory::Device,
                 "albedo_luminances"),
      states(context, sizeof(shaders::vec4) * vertex_count, gpu::Memory::Device, "albedo_states"),
      changes(context, vertex_count, gpu::TexelFormat::Rgba32f, "albedo_changes"),
      searches(context, 2 * static_cast<std::size_t>(vertex_count), gpu::TexelFormat::Rgba32f,
               "albedo_searches"),
      scalars(context,
              static_cast<std::size_t>(2 * pcg_iterations + 1) *
                  static_cast<std::size_t>(context.info().workgroup_count),
              gpu::TexelFormat::R32f, "albedo scalars") {
  clear(context, {&mean.buffer, &sums.buffer, &counts.buffer, &deviations.buffer});
}

float AlbedoState::gained_in_frame(std::uint32_t workgroup_count) const {
  float sum = 0;
  for (const float value : gained.mapped_as<float>().first(workgroup_count)) {
    sum += value;
  }
  return sum;
}

AlbedoKernels::AlbedoKernels(gpu::Context& context)
    : accumulate_(context, shaders::refine::kernels(), "refine/albedo_accumulate"),
      bend_(context, shaders::refine::kernels(), "refine/albedo_bend"),
      gradient_(context, shaders::refine::kernels(), "refine/albedo_gradient"),
      direction_(context, shaders::refine::kernels(), "refine/albedo_direction"),
      update_(context, shaders::refine::kernels(), "refine/albedo_update"),
      luminance_(context, shaders::refine::kernels(), "refine/albedo_luminance"),
      normalise_(context, shaders::refine::kernels(), "refine/albedo_normalise"),
      restrict_(context, shaders::refine::kernels(), "refine/restrict_albedo") {}

void AlbedoKernels::record(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                           const AlbedoState& albedo, const gpu::Buffer& frame, const gpu::Buffer& light,
                           const AlbedoOptions& options) const {
  const gpu::Groups groups{topology.workgroup_count};
  shaders::refine::AlbedoPush push{topology.vertex_count, 0, options.smooth_weight, options.frame_quota};
  batch.dispatch(accumulate_,
                 {{"frame", frame},
                  {"vertex_rings", topology.vertex_rings.view},
                  {"ring_indices", topology.ring_indices.view},
                  {"positions", state.positions.view},
                  {"normals", state.normals.view},
                  {"colours", state.colours.view},
                  {"mean_albedo", albedo.mean.view},
                  {"irradiance", state.irradiance.view},
                  {"light", light},
                  {"albedo_tints", albedo.tints},
                  {"albedo_sums", albedo.sums.buffer},
                  {"albedo_counts", albedo.counts.buffer},
                  {"albedo_gained", albedo.gained}},
                 groups, push);
  batch.dispatch(bend_,
                 {{"vertex_rings", topology.vertex_rings.view},
                  {"ring_indices", topology.ring_indices.view},
                  {"deviations", albedo.deviations.view},
                  {"albedo_sums", albedo.sums.view},
                  {"albedo_bends", albedo.bends.buffer},
                  {"albedo_units", albedo.units}},
                 groups, push);
  batch.dispatch(gradient_,
                 {{"vertex_rings", topology.vertex_rings.view},
                  {"ring_indices", topology.ring_indices.view},
                  {"deviations", albedo.deviations.view},
                  {"mean_albedo", albedo.mean.view},
                  {"albedo_tints", albedo.tints},
                  {"albedo_tint", albedo.tint},
                  {"albedo_sums", albedo.sums.view},
                  {"albedo_bends", albedo.bends.view},
                  {"albedo_units", albedo.units},
                  {"albedo_states", albedo.states},
                  {"albedo_changes", albedo.changes.buffer},
                  {"albedo_searches", albedo.searches.buffer},
                  {"sums", albedo.scalars.buffer}},
                 groups, push);
  for (int iteration = 0; iteration < options.pcg_iterations; ++iteration) {
    push.iteration = static_cast<std::uint32_t>(iteration);
    batch.dispatch(direction_,
                   {{"vertex_rings", topology.vertex_rings.view},
                    {"ring_indices", topology.ring_indices.view},
                    {"albedo_searches", albedo.searches.view},
                    {"albedo_changes", albedo.changes.view},
                    {"albedo_bends", albedo.bends.buffer},
                    {"sums", albedo.scalars.buffer}},
                   groups, push);
    batch.dispatch(update_,
                   {{"vertex_rings", topology.vertex_rings.view},
                    {"ring_indices", topology.ring_indices.view},
                    {"albedo_bends", albedo.bends.view},
                    {"albedo_states", albedo.states},
                    {"albedo_changes", albedo.changes.buffer},
                    {"albedo_searches", albedo.searches.buffer},
                    {"sums", albedo.scalars.buffer}},
                   groups, push);
  }
  batch.dispatch(luminance_,
                 {{"mean_albedo", albedo.mean.view},
                  {"albedo_changes", albedo.changes.view},
                  {"deviations", albedo.deviations.view},
                  {"albedo_counts", albedo.counts.view},
                  {"albedo_tint", albedo.tint},
                  {"albedo_luminances", albedo.luminances}},
                 groups, push);
  batch.dispatch(normalise_,
                 {{"mean_albedo", albedo.mean.view},
                  {"albedo_changes", albedo.changes.view},
                  {"albedo_counts", albedo.counts.buffer},
                  {"albedo_luminances", albedo.luminances},
                  {"albedo_tint", albedo.tint},
                  {"deviations", albedo.deviations.buffer},
                  {"albedo", state.albedo.buffer},
                  {"light", light}},
                 groups, push);
}

void AlbedoKernels::record_restrict(gpu::Batch& batch, const LevelTopology& finer_topology,
                                    const LevelState& finer, const LevelTopology& topology,
                                    const LevelState& state, const gpu::TexelView& in_finer) const {
  const shaders::refine::LevelPush push{topology.vertex_count, 0, 0, 0, 0};
  batch.dispatch(restrict_,
                 {{"vertex_rings", finer_topology.vertex_rings.view},
                  {"ring_indices", finer_topology.ring_indices.view},
                  {"finer", finer.albedo.view},
                  {"in_finer", in_finer},
                  {"albedo", state.albedo.buffer}},
                 {topology.workgroup_count}, push);
}

}  // namespace facet::refine
