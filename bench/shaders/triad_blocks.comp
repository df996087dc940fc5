#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// sums = a + 3 b, read through texel views, a contiguous block a workgroup: as the solver's kernels walk a level.

layout(local_size_x_id = 0) in;

uniform samplerBuffer a;
uniform samplerBuffer b;
writeonly buffer Sums { vec4 sums[]; };
layout(push_constant) uniform Push { CountPush push; };

void main() {
  uint block = (push.count + gl_NumWorkGroups.x - 1u) / gl_NumWorkGroups.x;
  uint first = gl_WorkGroupID.x * block;
  uint end = min(first + block, push.count);
  for (uint index = first + gl_LocalInvocationID.x; index < end; index += gl_WorkGroupSize.x) {
    sums[index] = texelFetch(a, int(index)) + 3.0 * texelFetch(b, int(index));
  }
}
