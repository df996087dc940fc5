#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "common/pcg.glsl"
#include "volume.glsl"
#include "adjoint.glsl"

// Second half of a CG iteration of [SF04 eq. 9]: x += alpha s, r -= alpha A s with A s = [I; Gx; Gy; Gt]^T q, z and r . z. The last
// iteration moves the disparities.

uniform samplerBuffer products;  // [t][y][x] of the windows
uniform usamplerBuffer links;
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
  ivec3 windows = window_extent();
  ivec3 region = search_extent();
  ivec2 cells = cells_of(box_extent, box_origin.z);
  float rz = 0;
  for (int at = cells.x + int(gl_LocalInvocationID.x); at < cells.y; at += int(kGroupSize)) {
    ivec3 cell = cell_at(at, box_extent);
    int voxel = voxel_of(box_origin + cell);
    int in_region = ((cell.z + 2) * region.y + cell.y + 2) * region.x + cell.x + 2;
    uint word = texelFetch(links, voxel).x;
    vec4 state = solver_states[at];
    vec2 search = searches[in_region];
    float s = search.x + beta * search.y;
    state.z += alpha * s;
    if (push.last != 0) {
      disparities[voxel] += clamp(state.z, -push.most_move_px, push.most_move_px);
    } else {
      int window = ((cell.z + 1) * windows.y + cell.y + 1) * windows.x + cell.x + 1;
      float product = adjoint(products, window, windows.x, windows.x * windows.y, word) + state.w * s;
      // What is no unknown has the preconditioner 0, which keeps z and s at 0.
      state.x -= alpha * product;
      float z = state.y * state.x;
      rz += state.x * z;
      searches[in_region] = vec2(z, s);
      solver_states[at] = state;
    }
  }
  float total = workgroup_sum(vec4(rz, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 2) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
