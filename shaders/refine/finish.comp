#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/finite.glsl"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "shading.glsl"

// What the host reads back of the finest level, in its order: displacements, how far each can be trusted, and
// the photometric error.

layout(push_constant) uniform Push {
  SolvePush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer positions;
uniform samplerBuffer normals;
uniform samplerBuffer colours;
uniform samplerBuffer albedo;
uniform samplerBuffer irradiance;
uniform isamplerBuffer handed_out_as;  // [vertex_count] index on the host
layout(std430) readonly buffer LightBlock {
  Light light;
};
layout(std430) writeonly buffer Results {
  vec2 results[];  // [vertex_count] displacement in mm, confidence 0 to 1
};
layout(std430) writeonly buffer ErrorSums {
  vec4 error_sums[];  // [workgroup] squared residuals, visible vertices, failed vertices, 0
};

#include "displaced_normal.glsl"

void main() {
  vec4 sum = vec4(0);
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    vec4 own = texelFetch(positions, int(i));
    vec4 colour = texelFetch(colours, int(i));
    float confidence = 0;
    float square = 0;
    if (colour.w > 0) {
      ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
      vec3 normal = displaced_unit_normal(ring, own.xyz + own.w * texelFetch(normals, int(i)).xyz);
      vec4 rho = texelFetch(albedo, int(i));
      vec3 residual = colour.rgb - shade(light, texelFetch(irradiance, int(i)), normal) * rho.rgb;
      square = dot(residual, residual);
      confidence = trust_in(ring) * colour.w * clamp(rho.w, 0, 1) * tukey_weight(light.gain * square, push.robust_scale);
      sum.xy += vec2(square, 1);
    }
    bool usable = is_finite(own.w) && is_finite(square) && is_finite(confidence) && abs(own.w) <= push.bound_mm;
    sum.z += usable ? 0 : 1;
    results[texelFetch(handed_out_as, int(i)).x] = usable ? vec2(own.w, confidence) : vec2(0);
  }
  sum = workgroup_sum(sum);
  if (gl_LocalInvocationID.x == 0) {
    error_sums[gl_WorkGroupID.x] = sum;
  }
}
