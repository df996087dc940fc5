#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"

// Four numbers a vertex (albedo and its confidence, the irradiance of the room's lamps) of a finer level, through the
// same stencils as its positions.

layout(push_constant) uniform Push {
  LevelPush push;
};
uniform isamplerBuffer stencil_rows;
uniform isamplerBuffer stencil_entries;
uniform samplerBuffer coarser;
layout(std430) writeonly buffer Values {
  vec4 values[];
};

void main() {
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 row = texelFetch(stencil_rows, int(i)).xy;
    vec4 sum = vec4(0);
    for (int k = 0; k < row.y; ++k) {
      ivec2 entry = texelFetch(stencil_entries, row.x + k).xy;
      sum += intBitsToFloat(entry.y) * texelFetch(coarser, entry.x);
    }
    values[i] = sum;
  }
}
