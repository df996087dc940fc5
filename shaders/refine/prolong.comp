#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"

// Pushes positions and displacements through the stencils to this level. The prolonged displacement is the
// prior pd [MD19 eq. 6], of a known relief with what this level has of it beyond the coarser ones; the start value adds
// what this level held beyond its prior in the previous frame.

layout(push_constant) uniform Push {
  LevelPush push;
};
layout(std140) uniform Frame {
  FrameParameters frame;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer stencil_rows;     // [vertex_count] first entry, entry count
uniform isamplerBuffer stencil_entries;  // column of the coarser level, weight as float bits
uniform samplerBuffer coarser;           // [coarser vertex_count] position, displacement
uniform samplerBuffer reliefs;           // [vertex_count] LevelState::reliefs
layout(std430) buffer Positions {
  vec4 positions[];  // [vertex_count] position, displacement
};
layout(std430) buffer Priors {
  float priors[];  // [vertex_count] pd
};

void main() {
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 row = texelFetch(stencil_rows, int(i)).xy;
    vec4 sum = vec4(0);
    for (int k = 0; k < row.y; ++k) {
      ivec2 entry = texelFetch(stencil_entries, row.x + k).xy;
      sum += intBitsToFloat(entry.y) * texelFetch(coarser, entry.x);
    }
    vec4 relief = texelFetch(reliefs, int(i));
    float prior = push.has_prior > 0 ? sum.w + relief.z : relief.x;
    float start = prior;
    if (frame.keep_displacements > 0 && push.refine > 0) {
      start += positions[i].w - priors[i];
    }
    if (!is_free(texelFetch(vertex_rings, int(i)).xy)) {
      prior *= push.fixed_keep_prior;
      start = prior;
    }
    // A level that shading leaves out is not held within the bound by the solver.
    positions[i] = vec4(sum.xyz, clamp(start, -push.bound_mm, push.bound_mm));
    priors[i] = prior;
  }
}
