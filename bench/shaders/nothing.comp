#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// Runs and does nothing where count is 0, but may write: each dispatch waits for the one before.

layout(local_size_x = 64) in;

buffer Values { uint values[]; };
layout(push_constant) uniform Push { CountPush push; };

void main() {
  if (gl_GlobalInvocationID.x < push.count) {
    values[gl_GlobalInvocationID.x] += 1u;
  }
}
