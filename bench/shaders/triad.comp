#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// sums = a + 3 b, one element of four an invocation, read from storage buffers.

layout(local_size_x_id = 0) in;

readonly buffer A { vec4 a[]; };
readonly buffer B { vec4 b[]; };
writeonly buffer Sums { vec4 sums[]; };
layout(push_constant) uniform Push { CountPush push; };

void main() {
  uint index = gl_GlobalInvocationID.x;
  if (index < push.count) {
    sums[index] = a[index] + 3.0 * b[index];
  }
}
