#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "common/pcg.glsl"

// First half of a PCG iteration for the albedo [MD19 eq. 4]: p = z + beta p, L p and p . A p.

layout(push_constant) uniform Push {
  AlbedoPush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer albedo_searches;  // [2 * vertex_count] z, p
uniform samplerBuffer albedo_changes;
layout(std430) writeonly buffer AlbedoBends {
  vec4 albedo_bends[];  // [vertex_count] w2 (L p)_i / ring size
};

void main() {
  float beta = pcg_beta(push.iteration);
  float curvature = 0;
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    vec3 sum = vec3(0);
    for (int k = 0; k < size; ++k) {
      int j = texelFetch(ring_indices, 4 * ring.x + k).x;
      sum += texelFetch(albedo_searches, 2 * j).rgb + beta * texelFetch(albedo_searches, 2 * j + 1).rgb;
    }
    vec3 own = texelFetch(albedo_searches, 2 * int(i)).rgb + beta * texelFetch(albedo_searches, 2 * int(i) + 1).rgb;
    float inverse_size = 1 / float(size);
    vec3 bend = own - sum * inverse_size;
    albedo_bends[i] = vec4(push.smooth_weight * inverse_size * bend, 0);
    curvature += push.smooth_weight * dot(bend, bend) + texelFetch(albedo_changes, int(i)).w * dot(own, own);
  }
  float total = workgroup_sum(vec4(curvature, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 1) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
