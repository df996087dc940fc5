#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"

// L rho - L rho_mean of [MD19 eq. 4] with rho = tint rho_mean + deviation, and the mean of sum w (l . SH)^2 over the
// vertices seen: the unit in which the data count.

layout(push_constant) uniform Push {
  AlbedoPush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer deviations;
uniform samplerBuffer albedo_sums;
layout(std430) writeonly buffer AlbedoBends {
  vec4 albedo_bends[];  // [vertex_count] w2 (L deviation)_i / ring size
};
layout(std430) writeonly buffer AlbedoUnits {
  vec2 albedo_units[];  // [workgroup] sum over vertices of sum w (l . SH)^2, vertices seen
};

void main() {
  vec2 unit = vec2(0);
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    vec3 sum = vec3(0);
    for (int k = 0; k < size; ++k) {
      int j = texelFetch(ring_indices, 4 * ring.x + k).x;
      sum += texelFetch(deviations, j).rgb;
    }
    vec3 own = texelFetch(deviations, int(i)).rgb;
    float inverse_size = 1 / float(size);
    albedo_bends[i] = vec4(push.smooth_weight * inverse_size * (own - sum * inverse_size), 0);
    float seen = texelFetch(albedo_sums, int(i)).w;
    unit += vec2(seen, seen > 0 ? 1 : 0);
  }
  vec4 total = workgroup_sum(vec4(unit, 0, 0));
  if (gl_LocalInvocationID.x == 0) {
    albedo_units[gl_WorkGroupID.x] = total.xy;
  }
}
