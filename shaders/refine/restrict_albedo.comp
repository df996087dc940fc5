#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"

// Albedo and its confidence of a coarser level from the next finer one's, which has the coarser level's
// vertices, too: half the vertex, half its neighbours, as the wider pixels that the level is compared with show it.

layout(push_constant) uniform Push {
  LevelPush push;  // of the coarser level
};
uniform isamplerBuffer vertex_rings;  // of the finer level
uniform isamplerBuffer ring_indices;
uniform samplerBuffer finer;
uniform isamplerBuffer in_finer;  // [vertex_count] of the coarser level: the vertex in the finer one
layout(std430) writeonly buffer Albedo {
  vec4 albedo[];
};

void main() {
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    int vertex = texelFetch(in_finer, int(i)).x;
    ivec2 ring = texelFetch(vertex_rings, vertex).xy;
    int size = ring_size(ring);
    vec4 sum = vec4(0);
    for (int k = 0; k < size; ++k) {
      sum += texelFetch(finer, texelFetch(ring_indices, 4 * ring.x + k).x);
    }
    albedo[i] = 0.5 * texelFetch(finer, vertex) + (0.5 / float(size)) * sum;
  }
}
