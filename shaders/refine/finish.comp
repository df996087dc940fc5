#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "shading.glsl"

// What the host reads back of the finest level: displacements, how far each can be trusted, and the
// photometric error.

layout(push_constant) uniform Push {
  SolvePush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer positions;
uniform samplerBuffer normals;
uniform samplerBuffer colours;
uniform samplerBuffer albedo;
layout(std430) readonly buffer LightBlock {
  Light light;
};
layout(std430) writeonly buffer Displacements {
  float displacements[];  // [vertex_count] mm
};
layout(std430) writeonly buffer Confidences {
  float confidences[];  // [vertex_count] 0 to 1
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
    if (colour.w > 0) {
      ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
      vec3 normal = displaced_unit_normal(ring, own.xyz + own.w * texelFetch(normals, int(i)).xyz);
      vec4 rho = texelFetch(albedo, int(i));
      vec3 residual = colour.rgb - shade(light, normal) * rho.rgb;
      float square = dot(residual, residual);
      confidence = trust_in(ring) * colour.w * clamp(rho.w, 0, 1) * tukey_weight(light.gain * square, push.robust_scale);
      sum.xy += vec2(square, 1);
    }
    bool usable = abs(own.w) <= push.bound_mm && confidence >= 0;
    sum.z += usable ? 0 : 1;
    displacements[i] = usable ? own.w : 0;
    confidences[i] = usable ? confidence : 0;
  }
  sum = workgroup_sum(sum);
  if (gl_LocalInvocationID.x == 0) {
    error_sums[gl_WorkGroupID.x] = sum;
  }
}
