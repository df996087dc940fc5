#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"

// Cameras differ in exposure and white balance. One gain per channel brings a further camera's colours to those
// of the reference camera: the ratio of what both show of the vertices of M0 that both see, over a few frames. One
// workgroup.

layout(push_constant) uniform Push {
  ViewPush push;
};
layout(std430) readonly buffer ViewSums {
  vec4 view_sums[];  // [group_count][2]
};
layout(std430) buffer Gain {
  ViewGain view_gain;
};

// What the sums keep from one frame to the next: about three frames count.
const float kMemory = 0.7;
// No two cameras that see the same face well differ by more than this factor.
const float kLargestGain = 16;

void main() {
  vec4 merged = vec4(0);
  vec4 seen = vec4(0);
  for (uint group = gl_LocalInvocationID.x; group < push.group_count; group += kGroupSize) {
    merged += view_sums[2 * group];
    seen += view_sums[2 * group + 1];
  }
  merged = workgroup_sum(merged);
  seen = workgroup_sum(seen);
  if (gl_LocalInvocationID.x == 0) {
    // A face that only one of them sees says nothing of their difference.
    if (merged.w > 0) {
      view_gain.merged_sum = kMemory * view_gain.merged_sum + merged;
      view_gain.view_sum = kMemory * view_gain.view_sum + seen;
    }
    vec3 gain = vec3(1);
    for (int c = 0; c < 3; ++c) {
      if (view_gain.view_sum[c] > 0 && view_gain.merged_sum[c] > 0) {
        gain[c] = clamp(view_gain.merged_sum[c] / view_gain.view_sum[c], 1 / kLargestGain, kLargestGain);
      }
    }
    view_gain.gain = vec4(gain, 0);
  }
}
