#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#extension GL_EXT_shader_atomic_float : require
#include "layout.h"

// The sum of all values by subgroups and an atomic addition.

layout(local_size_x = 64) in;

readonly buffer Values { float values[]; };
buffer Sum { float sum[]; };
layout(push_constant) uniform Push { CountPush push; };

void main() {
  uint index = gl_GlobalInvocationID.x;
  float mine = index < push.count ? values[index] : 0.0;
  float together = subgroupAdd(mine);
  if (subgroupElect()) {
    atomicAdd(sum[0], together);
  }
}
