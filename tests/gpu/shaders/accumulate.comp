#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// values[i] += neighbour values of the other buffer: a step that needs all of the step before.

layout(local_size_x = 64) in;

readonly buffer Previous { int previous[]; };
buffer Values { int values[]; };
layout(push_constant) uniform Push { CountPush push; };

void main() {
  uint index = gl_GlobalInvocationID.x;
  if (index < push.count) {
    values[index] += previous[(index * 7919u + 1u) % push.count] + 1;
  }
}
