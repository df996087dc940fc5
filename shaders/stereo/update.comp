#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "common/pcg.glsl"
#include "volume.glsl"
#include "unknowns.glsl"
#include "count.glsl"
#include "adjoint.glsl"

// Second half of a CG iteration of [SF04 eq. 9]: x += alpha s, r -= alpha A s with A s = [I; Gx; Gy; Gt]^T q, z and r . z. The last
// iteration moves the disparities.

uniform samplerBuffer products;
buffer SolverStates {
  vec4 solver_states[];
};
buffer Searches {
  vec2 searches[];
};
buffer Disparities {
  float disparities[];
};

void main() {
  float beta = pcg_beta(push.iteration);
  float alpha = pcg_alpha(push.iteration);
  ivec2 run = run_of(0, unknown_count);
  float rz = 0;
  for (int at = run.x + int(gl_LocalInvocationID.x); at < run.y; at += int(kGroupSize)) {
    ivec4 unknown = texelFetch(unknowns, at);
    vec4 state = solver_states[at];
    vec2 search = searches[at];
    float s = search.x + beta * search.y;
    state.z += alpha * s;
    if (push.last != 0) {
      disparities[voxel_of(place_of(unknown))] += clamp(state.z, -push.most_move_px, push.most_move_px);
    } else {
      state.x -= alpha * (adjoint(products, at, unknown) + push.damping * s);
      float z = state.y * state.x;
      rz += state.x * z;
      searches[at] = vec2(z, s);
      solver_states[at] = state;
    }
  }
  float total = workgroup_sum(vec4(rz, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 2) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
