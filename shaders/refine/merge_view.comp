#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"

// Lambert's shading is the same in every camera, so that
//   sum_v w_v |I_v - R|^2 = (sum_v w_v) |mean_v I - R|^2 + const:
// all that follows needs the mean colour and the weight of each vertex. Adds one camera's colours to those of
// the cameras before it; the last one bounds the weights to 1, as one camera's are.

layout(push_constant) uniform Push {
  ViewPush push;
};
uniform samplerBuffer view_colours;  // [vertex_count] linear RGB, weight 0 to 1
layout(std430) readonly buffer Gain {
  ViewGain view_gain;
};
layout(std430) buffer Colours {
  vec4 colours[];  // [vertex_count] linear RGB; sum of the weights so far
};

void main() {
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    vec4 merged = colours[i];
    vec4 own = texelFetch(view_colours, int(i));
    if (own.w > 0) {
      own.rgb *= view_gain.gain.rgb;
      float weight = merged.w + own.w;
      merged = vec4(merged.w > 0 ? mix(merged.rgb, own.rgb, own.w / weight) : own.rgb, weight);
    }
    if (push.last != 0) {
      merged.w = min(merged.w, 1);
    }
    colours[i] = merged;
  }
}
