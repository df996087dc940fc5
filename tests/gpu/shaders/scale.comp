#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// target = scale * source + offset, by elements of four.

layout(local_size_x = 64) in;

uniform samplerBuffer source;
writeonly buffer Target { vec4 target[]; };
layout(push_constant) uniform Push { ScalePush push; };

void main() {
  uint index = gl_GlobalInvocationID.x;
  if (index < push.count) {
    target[index] = push.scale * texelFetch(source, int(index)) + push.offset;
  }
}
