#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/finite.glsl"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "shading.glsl"

// E(d) [MD19 eq. 6] with E_data [MD19 eq. 2], the residuals of one Gauss-Newton step [MD19 eq. 7], and what their
// derivatives need.
//
// All three channels of R = (l . SH(n)) rho follow the normal through the one number l . SH(n), so the three
// data residuals of a vertex turned into the frame of rho are one residual that depends on the displacements
// and two that do not. With r = I - R and the metric M, the first is e = sqrt(w) rho . M r / |rho|_M, where
// |rho|_M^2 = rho . M rho; e and its slope d (w^1/2 |rho|_M l . SH) / d n* carry the step.

layout(push_constant) uniform Push {
  SolvePush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer positions;  // [vertex_count] position, displacement
uniform samplerBuffer normals;    // [vertex_count] unit coarse normal, spacing_mm
uniform samplerBuffer colours;    // [vertex_count] I, weight
uniform samplerBuffer albedo;     // [vertex_count] rho
uniform samplerBuffer irradiance;  // [vertex_count] of the room's lamps, x + yzw . n
uniform samplerBuffer priors;     // [vertex_count] pd
uniform samplerBuffer reliefs;    // [vertex_count] r, L r: the smoothness and w5 count from a known relief on
layout(std430) readonly buffer LightBlock {
  Light light;
};
layout(std430) writeonly buffer Slopes {
  vec4 slopes[];  // [vertex_count] d (sqrt(w) |rho|_M l . SH) / d n*, e
};
layout(std430) writeonly buffer Bends {
  vec2 bends[];  // [vertex_count] w3 (L d)_i / (spacing^2 ring size), w3 / (spacing ring size)^2
};
layout(std430) writeonly buffer Energies {
  float energies[];  // [slot][workgroup]
};

#include "displaced_normal.glsl"

void main() {
  float energy = 0;
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    vec4 own = texelFetch(positions, int(i));
    vec4 own_normal = texelFetch(normals, int(i));
    vec3 centre = own.xyz + own.w * own_normal.xyz;
    float sum;
    vec3 star = displaced_normal(ring, centre, sum);
    float inverse_spacing = 1 / own_normal.w;
    float inverse_size = 1 / float(size);
    vec2 relief = texelFetch(reliefs, int(i)).xy;
    float bend = (own.w - sum * inverse_size - relief.y) * inverse_spacing;
    float off = own.w - relief.x;
    float smooth_weight = push.smooth_weight * fold_weight(bend * bend, push.fold_slope);
    float bend_scale = smooth_weight * inverse_spacing * inverse_size;
    float beyond = (texelFetch(priors, int(i)).x - own.w) * inverse_spacing;
    energy += push.smooth_weight * fold_loss(bend * bend, push.fold_slope) + push.hierarchy_weight * beyond * beyond +
              push.coarse_weight * off * off;

    vec4 slope = vec4(0);
    vec4 colour = texelFetch(colours, int(i));
    colour.w *= trust_in(ring);
    if (colour.w > 0) {
      float inverse_length = inversesqrt(max(dot(star, star), 1e-30));
      vec3 normal = star * inverse_length;
      vec3 rho = texelFetch(albedo, int(i)).rgb;
      vec4 room = texelFetch(irradiance, int(i));
      vec3 residual = colour.rgb - shade(light, room, normal) * rho;
      vec3 metric_rho = metric_times(light, rho);
      float square = light.gain * dot(residual, metric_times(light, residual));
      float root = sqrt(colour.w * light.gain * tukey_weight(square, push.robust_scale));
      float length_rho = sqrt(max(dot(rho, metric_rho), 1e-12));
      vec3 gradient = shade_gradient(light, room, normal);
      slope.xyz = (root * length_rho * inverse_length) * (gradient - normal * dot(normal, gradient));
      slope.w = root * dot(metric_rho, residual) / length_rho;
      energy += colour.w * tukey_loss(square, push.robust_scale);
      // Tukey's loss may take what is no number for an outlier; then the host would not learn of it.
      if (!is_finite(square)) {
        energy = uintBitsToFloat(kNotANumberBits);
      }
    }
    slopes[i] = slope;
    bends[i] = vec2(bend_scale * bend, bend_scale * inverse_spacing * inverse_size);
  }
  float total = workgroup_sum(vec4(energy, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    energies[push.energy_slot * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
