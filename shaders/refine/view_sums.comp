#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"

// What view_gain compares: the colours of M0's vertices that a further camera and those before it both see, weighted by
// the smaller trust of the two, summed over each workgroup's vertices.

layout(push_constant) uniform Push {
  ViewPush push;
};
uniform samplerBuffer colours;       // [vertex_count] linear RGB of the cameras before, weight
uniform samplerBuffer view_colours;  // [vertex_count] of this camera
layout(std430) writeonly buffer ViewSums {
  vec4 view_sums[];  // [workgroup][2] weighted RGB of the cameras before, weights; of this camera
};

void main() {
  vec4 merged = vec4(0);
  vec4 seen = vec4(0);
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    vec4 before = texelFetch(colours, int(i));
    vec4 own = texelFetch(view_colours, int(i));
    float weight = min(before.w, own.w);
    if (weight > 0) {
      merged += weight * vec4(before.rgb, 1);
      seen += weight * vec4(own.rgb, 1);
    }
  }
  merged = workgroup_sum(merged);
  seen = workgroup_sum(seen);
  if (gl_LocalInvocationID.x == 0) {
    view_sums[2 * gl_WorkGroupID.x] = merged;
    view_sums[2 * gl_WorkGroupID.x + 1] = seen;
  }
}
