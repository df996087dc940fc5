#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "common/pcg.glsl"

// First half of a PCG iteration: p = z + beta p, J p, and p . A p = |J p|^2 + the other terms' squares, so
// that J^T J p need not be known yet.

layout(push_constant) uniform Push {
  SolvePush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_groups;
uniform samplerBuffer normals;
uniform samplerBuffer bends;
uniform samplerBuffer jacobian_rows;  // [group_count] four entries
uniform samplerBuffer searches;       // [vertex_count + 1] z, p of the iteration before
uniform samplerBuffer sums_so_far;
layout(std430) writeonly buffer Products {
  vec2 products[];  // [vertex_count + 1] (J p)_i, w3 (L p)_i / (spacing^2 ring size)
};
layout(std430) writeonly buffer Sums {
  float sums[];
};

void main() {
  float beta = pcg_beta(sums_so_far, push.iteration);
  float curvature = 0;
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    float data = 0;
    float sum = 0;
    int end = ring.x + (size + 3) / 4;
    for (int group = ring.x; group < end; ++group) {
      ivec4 j = texelFetch(ring_groups, group);
      vec4 row = texelFetch(jacobian_rows, group);
      vec2 a = texelFetch(searches, j.x).xy;
      vec2 b = texelFetch(searches, j.y).xy;
      vec2 c = texelFetch(searches, j.z).xy;
      vec2 d = texelFetch(searches, j.w).xy;
      vec4 p = vec4(a.x, b.x, c.x, d.x) + beta * vec4(a.y, b.y, c.y, d.y);
      data += dot(row, p);
      sum += (p.x + p.y) + (p.z + p.w);
    }
    vec2 search = texelFetch(searches, int(i)).xy;
    float own = search.x + beta * search.y;
    float inverse_spacing = 1 / texelFetch(normals, int(i)).w;
    float stiffness = texelFetch(bends, int(i)).y * float(size);
    float bend = own * float(size) - sum;
    products[i] = vec2(data, stiffness * bend / float(size));
    curvature += data * data + stiffness * bend * bend / float(size) +
                 (push.hierarchy_weight * inverse_spacing * inverse_spacing + push.coarse_weight) * own * own;
  }
  float total = workgroup_sum(vec4(curvature, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 1) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
