#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"

// Ends the albedo solve. Light times albedo is all that an image shows, so the albedo's mean luminance over
// the vertices seen is set to the face model's, and the light takes the other factor.

layout(push_constant) uniform Push {
  AlbedoPush push;
};
uniform samplerBuffer mean_albedo;
uniform samplerBuffer albedo_changes;
layout(std430) readonly buffer AlbedoCounts {
  float albedo_counts[];
};
layout(std430) readonly buffer AlbedoLuminances {
  vec2 albedo_luminances[];  // [workgroup] see albedo_luminance
};
layout(std430) readonly buffer AlbedoTint {
  vec4 albedo_tint;
};
layout(std430) buffer Deviations {
  vec4 deviations[];  // [vertex_count] rho - tint rho_mean
};
layout(std430) writeonly buffer Albedo {
  vec4 albedo[];  // [vertex_count] rho, confidence 0 to 1
};
layout(std430) buffer LightBlock {
  Light light;
};

// No skin or hair reflects less or more; outside, the solve has gone astray.
const float kDarkest = 0.005;
const float kBrightest = 1.2;

void main() {
  vec4 sum = vec4(0);
  for (uint group = gl_LocalInvocationID.x; group < gl_NumWorkGroups.x; group += kGroupSize) {
    sum.xy += albedo_luminances[group];
  }
  sum = workgroup_sum(sum);
  float scale = sum.x > 0 && sum.y > 0 ? sum.y / sum.x : 1;
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    vec3 deviation = deviations[i].rgb + texelFetch(albedo_changes, int(i)).rgb;
    bool usable = all(lessThan(abs(deviation), vec3(1e3)));
    deviation = usable ? deviation : vec3(0);
    deviations[i] = vec4(deviation, 0);
    vec3 rho = scale * (albedo_tint.rgb * texelFetch(mean_albedo, int(i)).rgb + deviation);
    rho = clamp(rho, vec3(kDarkest), vec3(kBrightest));
    albedo[i] = vec4(rho, min(1.0, albedo_counts[i] / push.frame_quota));
  }
  if (gl_GlobalInvocationID.x == 0) {
    light.low /= scale;
    light.middle /= scale;
    light.last /= scale;
    light.room /= scale;
  }
}
