#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"

// What albedo_normalise needs of all vertices: the luminance of what was seen, as the solve left it and as the face
// model has it, of each workgroup's vertices.

layout(push_constant) uniform Push {
  AlbedoPush push;
};
uniform samplerBuffer mean_albedo;
uniform samplerBuffer albedo_changes;
uniform samplerBuffer deviations;
uniform samplerBuffer albedo_counts;
layout(std430) readonly buffer AlbedoTint {
  vec4 albedo_tint;
};
layout(std430) writeonly buffer AlbedoLuminances {
  vec2 albedo_luminances[];  // [workgroup] sums over the vertices seen: luminance of rho, of rho_mean
};

const vec3 kLuminance = vec3(0.2126, 0.7152, 0.0722);

void main() {
  vec2 sum = vec2(0);
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    if (texelFetch(albedo_counts, int(i)).x > 0) {
      vec3 mean = texelFetch(mean_albedo, int(i)).rgb;
      vec3 rho = albedo_tint.rgb * mean + texelFetch(deviations, int(i)).rgb + texelFetch(albedo_changes, int(i)).rgb;
      sum += vec2(dot(kLuminance, rho), dot(kLuminance, mean));
    }
  }
  vec4 total = workgroup_sum(vec4(sum, 0, 0));
  if (gl_LocalInvocationID.x == 0) {
    albedo_luminances[gl_WorkGroupID.x] = total.xy;
  }
}
