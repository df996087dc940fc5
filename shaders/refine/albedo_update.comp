#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "common/pcg.glsl"

// Second half of a PCG iteration for the albedo [MD19 eq. 4].

layout(push_constant) uniform Push {
  AlbedoPush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer albedo_bends;
layout(std430) buffer AlbedoStates {
  vec4 albedo_states[];
};
layout(std430) buffer AlbedoChanges {
  vec4 albedo_changes[];
};
layout(std430) buffer AlbedoSearches {
  vec4 albedo_searches[];
};

void main() {
  float beta = pcg_beta(push.iteration);
  float alpha = pcg_alpha(push.iteration);
  float rz = 0;
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    vec3 bends = vec3(0);
    for (int k = 0; k < size; ++k) {
      bends += texelFetch(albedo_bends, texelFetch(ring_indices, 4 * ring.x + k).x).rgb;
    }
    vec3 p = albedo_searches[2 * i].rgb + beta * albedo_searches[2 * i + 1].rgb;
    vec4 change = albedo_changes[i];
    vec4 state = albedo_states[i];
    vec3 product = texelFetch(albedo_bends, int(i)).rgb * float(size) - bends + change.w * p;
    change.rgb += alpha * p;
    state.rgb -= alpha * product;
    rz += state.w * dot(state.rgb, state.rgb);
    albedo_changes[i] = change;
    albedo_states[i] = state;
    albedo_searches[2 * i] = vec4(state.w * state.rgb, 0);
    albedo_searches[2 * i + 1] = vec4(p, 0);
  }
  float total = workgroup_sum(vec4(rz, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 2) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
