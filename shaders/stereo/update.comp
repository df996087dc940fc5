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
// iteration moves the disparities. What an iteration reads and what it writes are different arrays, in turn.

uniform samplerBuffer products;
uniform samplerBuffer inverses;
uniform samplerBuffer solver_states;
uniform samplerBuffer searches;
writeonly buffer NextStates {
  vec2 next_states[];  // r, x
};
writeonly buffer NextSearches {
  vec2 next_searches[];  // z, search
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
    vec2 state = texelFetch(solver_states, at).xy;
    vec2 search = texelFetch(searches, at).xy;
    float s = search.x + beta * search.y;
    float x = state.y + alpha * s;
    if (push.last != 0) {
      disparities[voxel_of(place_of(unknown))] += clamp(x, -push.most_move_px, push.most_move_px);
    } else {
      float r = state.x - alpha * (adjoint(products, at, unknown) + push.damping * s);
      float z = texelFetch(inverses, at).x * r;
      rz += r * z;
      next_searches[at] = vec2(z, s);
      next_states[at] = vec2(r, x);
    }
  }
  float total = workgroup_sum(vec4(rz, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 2) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
