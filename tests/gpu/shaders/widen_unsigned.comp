#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// Widens an unsigned texel buffer to four integers for each element.

layout(local_size_x = 64) in;

uniform usamplerBuffer source;
writeonly buffer Target { uvec4 target[]; };
layout(push_constant) uniform Push { CountPush push; };

void main() {
  uint index = gl_GlobalInvocationID.x;
  if (index < push.count) {
    target[index] = texelFetch(source, int(index));
  }
}
