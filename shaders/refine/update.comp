#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "common/pcg.glsl"

// Second half of a PCG iteration [MD19 sec. 4.4] for [MD19 eq. 8]: x += alpha p, r -= alpha A p with A p = J^T (J p) + the other terms, z, and
// r . z. The last iteration moves the displacements.

layout(push_constant) uniform Push {
  SolvePush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_groups;
uniform samplerBuffer jacobian_columns;  // [group_count] four entries
uniform samplerBuffer products;          // [vertex_count + 1] J p, bend, p, own diagonal
uniform samplerBuffer states_before;     // [vertex_count] read ahead, so that memory's delay hides behind the ring
layout(std430) writeonly buffer SolverStates {
  vec4 solver_states[];
};
layout(std430) writeonly buffer Preconditioned {
  float preconditioned[];
};
layout(std430) buffer Positions {
  vec4 positions[];
};

void main() {
  float alpha = pcg_alpha(push.iteration);
  float rz = 0;
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    int size = ring_size(ring);
    vec4 state = texelFetch(states_before, int(i));
    vec4 own = texelFetch(products, int(i));
    float data = 0;
    float bends = 0;
    int end = ring.x + (size + 3) / 4;
    for (int group = ring.x; group < end; ++group) {
      ivec4 j = texelFetch(ring_groups, group);
      vec4 column = texelFetch(jacobian_columns, group);
      vec2 a = texelFetch(products, j.x).xy;
      vec2 b = texelFetch(products, j.y).xy;
      vec2 c = texelFetch(products, j.z).xy;
      vec2 d = texelFetch(products, j.w).xy;
      data += dot(column, vec4(a.x, b.x, c.x, d.x));
      bends += (a.y + b.y) + (c.y + d.y);
    }
    float p = own.z;
    float own_bend = own.y * float(size);
    state.z += alpha * p;
    // A fixed vertex has no unknown: its preconditioner is 0 and keeps z and p at 0.
    state.x -= alpha * (data + own_bend - bends + own.w * p);
    float z = state.y * state.x;
    rz += state.x * z;
    preconditioned[i] = z;
    if (push.last != 0) {
      vec4 position = positions[i];
      position.w = clamp(position.w + state.z, -push.bound_mm, push.bound_mm);
      positions[i] = position;
    } else {
      solver_states[i] = state;
    }
  }
  float total = workgroup_sum(vec4(rz, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 2) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
