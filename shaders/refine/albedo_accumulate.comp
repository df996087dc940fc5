#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "shading.glsl"

// Adds the frame to the sums that [MD19 eq. 4] over several frames needs: w (l . SH) I and w (l . SH)^2 of every
// vertex. A vertex learns until it has been seen in frame_quota frames, whenever those come.

layout(push_constant) uniform Push {
  AlbedoPush push;
};
layout(std140) uniform Frame {
  FrameParameters frame;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer positions;
uniform samplerBuffer normals;
uniform samplerBuffer colours;
uniform samplerBuffer mean_albedo;
uniform samplerBuffer irradiance;
layout(std430) readonly buffer LightBlock {
  Light light;
};
layout(std430) buffer AlbedoSums {
  vec4 albedo_sums[];  // [vertex_count] sum of w (l . SH) I, sum of w (l . SH)^2
};
layout(std430) buffer AlbedoCounts {
  float albedo_counts[];  // [vertex_count] sum of w
};
layout(std430) writeonly buffer AlbedoGained {
  float albedo_gained[];  // [workgroup] sum of w that this frame added
};
layout(std430) writeonly buffer AlbedoTints {
  vec4 albedo_tints[];  // [workgroup][2] sums over vertices: seen times mean albedo; mean albedo squared
};

#include "displaced_normal.glsl"

// The light is of the order of 1; a failed solve may give anything, and sums forget nothing.
const float kStrongest = 1e3;

void main() {
  float gained = 0;
  vec4 seen_sum = vec4(0);
  vec4 mean_sum = vec4(0);
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    vec4 colour = texelFetch(colours, int(i));
    vec4 total_seen = albedo_sums[i];
    if (frame.learn_albedo > 0 && colour.w > 0 && albedo_counts[i] < push.frame_quota) {
      ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
      vec4 own = texelFetch(positions, int(i));
      float s = shade(light, texelFetch(irradiance, int(i)),
                      displaced_unit_normal(ring, own.xyz + own.w * texelFetch(normals, int(i)).xyz));
      if (abs(s) < kStrongest) {
        total_seen += colour.w * light.gain * s * vec4(colour.rgb, s);
        albedo_sums[i] = total_seen;
        albedo_counts[i] += colour.w;
        gained += colour.w;
      }
    }
    vec3 mean = texelFetch(mean_albedo, int(i)).rgb;
    seen_sum.rgb += total_seen.rgb * mean;
    mean_sum.rgb += total_seen.w * mean * mean;
  }
  float total = workgroup_sum(vec4(gained, 0, 0, 0)).x;
  seen_sum = workgroup_sum(seen_sum);
  mean_sum = workgroup_sum(mean_sum);
  if (gl_LocalInvocationID.x == 0) {
    albedo_gained[gl_WorkGroupID.x] = total;
    albedo_tints[2 * gl_WorkGroupID.x] = seen_sum;
    albedo_tints[2 * gl_WorkGroupID.x + 1] = mean_sum;
  }
}
