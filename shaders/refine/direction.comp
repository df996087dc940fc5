#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "common/pcg.glsl"

// First half of a PCG iteration [MD19 sec. 4.4] for [MD19 eq. 8]: p = z + beta p, J p and L p, and p . A p = |J p|^2 + the other terms'
// squares, so that J^T J p need not be known yet. Products follow p: J p = J z + beta (J p of the iteration
// before), so the rings are read for one number a vertex, z.

layout(push_constant) uniform Push {
  SolvePush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_groups;
uniform samplerBuffer bends;
uniform samplerBuffer jacobian_rows;  // [group_count] four entries
uniform samplerBuffer preconditioned;  // [vertex_count + 1] z
uniform samplerBuffer products_before;  // of the iteration before
layout(std430) writeonly buffer Products {
  vec4 products[];  // [vertex_count + 1] (J p)_i, w3 (L p)_i / (spacing^2 ring size), p,
                    // diagonal of the terms in d_i alone
};

void main() {
  float beta = pcg_beta(push.iteration);
  float curvature = 0;
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    vec4 before = texelFetch(products_before, int(i));
    float data = 0;
    float sum = 0;
    int end = ring.x + (size + 3) / 4;
    for (int group = ring.x; group < end; ++group) {
      ivec4 j = texelFetch(ring_groups, group);
      vec4 row = texelFetch(jacobian_rows, group);
      vec4 z = vec4(texelFetch(preconditioned, j.x).x, texelFetch(preconditioned, j.y).x,
                    texelFetch(preconditioned, j.z).x, texelFetch(preconditioned, j.w).x);
      data += dot(row, z);
      sum += (z.x + z.y) + (z.z + z.w);
    }
    float own = texelFetch(preconditioned, int(i)).x;
    float stiffness = texelFetch(bends, int(i)).y;
    vec3 product = vec3(data, stiffness * (own * float(size) - sum), own) + beta * before.xyz;
    products[i] = vec4(product, before.w);
    curvature += product.x * product.x + (stiffness > 0 ? product.y * product.y / stiffness : 0) +
                 before.w * product.z * product.z;
  }
  float total = workgroup_sum(vec4(curvature, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 1) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
