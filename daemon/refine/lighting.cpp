#include "refine/lighting.hpp"

#include "refine_shaders.hpp"

namespace facet::refine {
namespace {

// As in shaders/refine/lighting.glsl.
constexpr std::size_t kLightingSums = 22;

}  // namespace

shaders::refine::Light pack_light(const std::array<float, 9>& l, float gain) {
  return {{l[0], l[1], l[2], l[3]},
          {l[4], l[5], l[6], l[7]},
          l[8],
          gain,
          0,
          1,
          {1, 1, 1, 0},
          {0, 0, 0, 0},
          {1, 0, 0, 0}};
}

std::array<float, 9> unpack_light(const shaders::refine::Light& light) {
  return {light.low.x,    light.low.y,    light.low.z,    light.low.w, light.middle.x,
          light.middle.y, light.middle.z, light.middle.w, light.last};
}

LightingState::LightingState(gpu::Context& context)
    : light(context, sizeof(shaders::refine::Light), gpu::Memory::Device, "light"),
      previous(context, sizeof(shaders::refine::Light), gpu::Memory::Device, "previous light"),
      sums(context, sizeof(shaders::vec4) * kLightingSums * context.info().workgroup_count,
           gpu::Memory::Device, "lighting_sums") {
  clear(context, {&light});
}

LightingKernels::LightingKernels(gpu::Context& context)
    : sums_(context, shaders::refine::kernels(), "refine/lighting_sums"),
      solve_(context, shaders::refine::kernels(), "refine/lighting_solve") {}

void LightingKernels::record_pass(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                                  const LightingState& lighting, const gpu::Buffer& frame,
                                  const LightingOptions& options, float robust_scale) const {
  const shaders::refine::LightingPush push{topology.vertex_count, topology.workgroup_count,
                                           options.temporal_weight, robust_scale, options.metric_floor};
  batch.dispatch(sums_,
                 {{"vertex_rings", topology.vertex_rings.view},
                  {"ring_indices", topology.ring_indices.view},
                  {"positions", state.positions.view},
                  {"normals", state.normals.view},
                  {"colours", state.colours.view},
                  {"albedo", state.albedo.view},
                  {"irradiance", state.irradiance.view},
                  {"light", lighting.light},
                  {"lighting_sums", lighting.sums}},
                 {topology.workgroup_count}, push);
  batch.dispatch(solve_,
                 {{"frame", frame},
                  {"lighting_sums", lighting.sums},
                  {"previous", lighting.previous},
                  {"light", lighting.light}},
                 {}, push);
}

void LightingKernels::record(gpu::Batch& batch, const LevelTopology& topology, const LevelState& state,
                             const LightingState& lighting, const gpu::Buffer& frame,
                             const LightingOptions& options) const {
  batch.copy(lighting.light, lighting.previous);
  record_pass(batch, topology, state, lighting, frame, options, 0);
  if (options.robust_scale > 0) {
    record_pass(batch, topology, state, lighting, frame, options, options.robust_scale);
  }
}

}  // namespace facet::refine
