#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"

// The data term's Jacobian, by rows for J p and by columns for J^T q, and the start of the PCG solve of [MD19 eq. 8]:
// r = J^T (y - f) and its Jacobi preconditioner.
//
// n*_i of a closed ring does not depend on d_i, and d n*_i / d d_j = n_j x (a_next - a_previous), where a are
// the displaced vertices before and after j in the ring of i. The same two, seen from j, swap places.

layout(push_constant) uniform Push {
  SolvePush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer positions;
uniform samplerBuffer normals;
uniform samplerBuffer slopes;
uniform samplerBuffer bends;
uniform samplerBuffer priors;
uniform samplerBuffer reliefs;
layout(std430) writeonly buffer JacobianRows {
  uvec2 jacobian_rows[];  // [group_count] four float16: d e_i / d d_j in the order of the ring
};
layout(std430) writeonly buffer JacobianColumns {
  uvec2 jacobian_columns[];  // [group_count] four float16: d e_j / d d_i in the order of the ring
};
layout(std430) writeonly buffer SolverStarts {
  vec4 solver_starts[];  // [vertex_count] r, inverse diagonal, diagonal of the terms in d_i alone,
                         // w3 / (spacing ring size)^2
};

void main() {
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    int first = 4 * ring.x;
    int groups = (size + 3) / 4;
    vec4 own = texelFetch(positions, int(i));
    vec4 own_normal = texelFetch(normals, int(i));
    vec3 own_slope = texelFetch(slopes, int(i)).xyz;
    bool closed = is_closed(ring);

    int j = texelFetch(ring_indices, first + size - 1).x;
    vec4 neighbour = texelFetch(positions, j);
    vec3 previous = neighbour.xyz + neighbour.w * texelFetch(normals, j).xyz;
    j = texelFetch(ring_indices, first).x;
    neighbour = texelFetch(positions, j);
    vec3 normal = texelFetch(normals, j).xyz;
    vec3 current = neighbour.xyz + neighbour.w * normal;

    float data = 0;
    float data_diagonal = 0;
    float bend_sum = 0;
    float bend_diagonal = 0;
    for (int group = 0; group < groups; ++group) {
      vec4 row = vec4(0);
      vec4 column = vec4(0);
      for (int lane = 0; lane < 4; ++lane) {
        int k = 4 * group + lane;
        if (k < size) {
          int next_j = texelFetch(ring_indices, first + (k + 1 < size ? k + 1 : 0)).x;
          neighbour = texelFetch(positions, next_j);
          vec3 next_normal = texelFetch(normals, next_j).xyz;
          vec3 next = neighbour.xyz + neighbour.w * next_normal;
          vec4 slope = texelFetch(slopes, j);
          vec2 bend = texelFetch(bends, j).xy;
          vec3 across = next - previous;
          row[lane] = dot(own_slope, cross(normal, across));
          float entry = dot(slope.xyz, cross(across, own_normal.xyz));
          column[lane] = entry;
          data += entry * slope.w;
          data_diagonal += entry * entry;
          bend_sum += bend.x;
          bend_diagonal += bend.y;
          previous = current;
          current = next;
          normal = next_normal;
          j = next_j;
        }
      }
      jacobian_rows[ring.x + group] = uvec2(packHalf2x16(row.xy), packHalf2x16(row.zw));
      jacobian_columns[ring.x + group] = uvec2(packHalf2x16(column.xy), packHalf2x16(column.zw));
    }

    vec2 own_bends = texelFetch(bends, int(i)).xy;
    vec4 start = vec4(0, 0, 0, own_bends.y);
    // A fixed vertex has no unknown: its preconditioner is 0 and keeps z and p at 0.
    if (is_free(ring)) {
      float inverse_square = 1 / (own_normal.w * own_normal.w);
      float own_bend = own_bends.x * float(size);
      start.z = push.hierarchy_weight * inverse_square + push.coarse_weight;
      float diagonal = data_diagonal + own_bends.y * float(size * size) + bend_diagonal + start.z;
      start.x = data - (own_bend - bend_sum) +
                push.hierarchy_weight * inverse_square * (texelFetch(priors, int(i)).x - own.w) -
                push.coarse_weight * (own.w - texelFetch(reliefs, int(i)).x);
      start.y = diagonal > 0 ? 1 / diagonal : 0;
    }
    solver_starts[i] = start;
  }
}
