#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"

// Start of the PCG solve of [MD19 eq. 4]'s normal equations, the three channels as one system. What no frame has
// shown is held near the mean albedo, tinted as a whole to what the frames have shown: Jacobi's preconditioner
// would take hundreds of iterations to carry one colour over the face.

layout(push_constant) uniform Push {
  AlbedoPush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer deviations;  // [vertex_count] rho - tint rho_mean
uniform samplerBuffer mean_albedo;
uniform samplerBuffer albedo_sums;
uniform samplerBuffer albedo_bends;
layout(std430) readonly buffer AlbedoUnits {
  vec2 albedo_units[];
};
layout(std430) readonly buffer AlbedoTints {
  vec4 albedo_tints[];
};
layout(std430) writeonly buffer AlbedoTint {
  vec4 albedo_tint;  // for albedo_normalise
};
layout(std430) writeonly buffer AlbedoStates {
  vec4 albedo_states[];  // [vertex_count] r, inverse diagonal
};
layout(std430) writeonly buffer AlbedoChanges {
  vec4 albedo_changes[];  // [vertex_count] x, diagonal of the terms in rho_i alone
};
layout(std430) writeonly buffer AlbedoSearches {
  vec4 albedo_searches[];  // [2 * vertex_count] z, then p of the iteration before
};
layout(std430) writeonly buffer Sums {
  float sums[];
};

// Relative to a vertex of mean brightness in all frames.
const float kMeanPrior = 1e-3;

void main() {
  vec2 unit_sums = vec2(0);
  vec3 seen_sum = vec3(0);
  vec3 mean_sum = vec3(0);
  for (uint group = gl_LocalInvocationID.x; group < gl_NumWorkGroups.x; group += kGroupSize) {
    unit_sums += albedo_units[group];
    seen_sum += albedo_tints[2 * group].rgb;
    mean_sum += albedo_tints[2 * group + 1].rgb;
  }
  vec4 first_sums = workgroup_sum(vec4(seen_sum, unit_sums.x));
  vec4 second_sums = workgroup_sum(vec4(mean_sum, unit_sums.y));
  seen_sum = first_sums.rgb;
  mean_sum = second_sums.rgb;
  unit_sums = vec2(first_sums.w, second_sums.w);
  vec3 tint = all(greaterThan(mean_sum, vec3(0))) ? seen_sum / mean_sum : vec3(1);
  if (gl_GlobalInvocationID.x == 0) {
    albedo_tint = vec4(tint, 0);
  }
  float inverse_unit = unit_sums.x > 0 ? unit_sums.y / unit_sums.x : 0;
  float rz = 0;
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    vec3 bends = vec3(0);
    float bend_diagonal = 1;
    for (int k = 0; k < size; ++k) {
      int j = texelFetch(ring_indices, 4 * ring.x + k).x;
      bends += texelFetch(albedo_bends, j).rgb;
      float other_size = float(ring_size(texelFetch(vertex_rings, j).xy));
      bend_diagonal += 1 / (other_size * other_size);
    }
    vec3 deviation = texelFetch(deviations, int(i)).rgb;
    vec3 own = tint * texelFetch(mean_albedo, int(i)).rgb + deviation;
    vec4 seen = texelFetch(albedo_sums, int(i)) * inverse_unit;
    vec3 r = seen.rgb - seen.w * own - (texelFetch(albedo_bends, int(i)).rgb * float(size) - bends) -
             kMeanPrior * deviation;
    float alone = seen.w + kMeanPrior;
    float inverse_diagonal = 1 / (alone + push.smooth_weight * bend_diagonal);
    albedo_states[i] = vec4(r, inverse_diagonal);
    albedo_changes[i] = vec4(0, 0, 0, alone);
    albedo_searches[2 * i] = vec4(inverse_diagonal * r, 0);
    albedo_searches[2 * i + 1] = vec4(0);
    rz += inverse_diagonal * dot(r, r);
  }
  float total = workgroup_sum(vec4(rz, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[gl_WorkGroupID.x] = total;
  }
}
