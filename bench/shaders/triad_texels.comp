#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// sums = a + 3 b, one element of four an invocation, read through texel views.

layout(local_size_x_id = 0) in;

uniform samplerBuffer a;
uniform samplerBuffer b;
writeonly buffer Sums { vec4 sums[]; };
layout(push_constant) uniform Push { CountPush push; };

void main() {
  uint index = gl_GlobalInvocationID.x;
  if (index < push.count) {
    sums[index] = texelFetch(a, int(index)) + 3.0 * texelFetch(b, int(index));
  }
}
