#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "adjoint.glsl"

// Start of the CG solve of [SF04 eq. 9]: r = -[I; Gx; Gy; Gt]^T b, its Jacobi preconditioner, z and the first r . z.
// Outside the box the search is 0: neighbours are boundary values.

uniform samplerBuffer hessians;
uniform samplerBuffer gradients;
uniform usamplerBuffer links;
writeonly buffer SolverStates {
  vec4 solver_states[];  // [t][y][x] of the box: r, inverse diagonal, x, damping
};
writeonly buffer Searches {
  vec2 searches[];  // [t][y][x] of the search region: z, search of the iteration before
};
writeonly buffer Sums {
  float sums[];  // [2 * iteration][workgroup] r . z, s . A s
};

float own_coefficient(uint bits) { return adjoint_own(1, bits); }

// Of [I; Gx; Gy; Gt]^T J [I; Gx; Gy; Gt], exact: where a window says nothing, those beside it hold its disparity.
float diagonal(int at, int plane, int stride_y, int stride_t, uint word) {
  uint x = axis_bits(word, 0);
  uint y = axis_bits(word, 1);
  uint t = axis_bits(word, 2);
  vec3 own = vec3(own_coefficient(x), own_coefficient(y), own_coefficient(t));
  vec4 first = texelFetch(hessians, at);
  vec4 second = texelFetch(hessians, at + plane);
  vec2 third = texelFetch(hessians, at + 2 * plane).xy;
  float sum = first.x + dot(own * own, vec3(second.xw, third.y)) +
              2 * (dot(own, first.yzw) + own.x * dot(own.yz, second.yz) + own.y * own.z * third.x);
  float before = adjoint_before(x);
  float after = adjoint_after(x);
  sum += before * before * texelFetch(hessians, at + plane - 1).x + after * after * texelFetch(hessians, at + plane + 1).x;
  before = adjoint_before(y);
  after = adjoint_after(y);
  sum += before * before * texelFetch(hessians, at + plane - stride_y).w +
         after * after * texelFetch(hessians, at + plane + stride_y).w;
  before = adjoint_before(t);
  after = adjoint_after(t);
  return sum + before * before * texelFetch(hessians, at + 2 * plane - stride_t).y +
         after * after * texelFetch(hessians, at + 2 * plane + stride_t).y;
}

void main() {
  ivec3 extent = search_extent();
  ivec3 windows = window_extent();
  int plane = windows.x * windows.y * windows.z;
  ivec2 cells = cells_of(extent, box_origin.z - 2);
  float rz = 0;
  for (int cell = cells.x + int(gl_LocalInvocationID.x); cell < cells.y; cell += int(kGroupSize)) {
    ivec3 here = cell_at(cell, extent) - 2;
    float z = 0;
    if (all(greaterThanEqual(here, ivec3(0))) && all(lessThan(here, box_extent))) {
      uint word = texelFetch(links, voxel_of(box_origin + here)).x;
      vec4 state = vec4(0);
      if ((word & kSolved) != 0) {
        int at = ((here.z + 1) * windows.y + here.y + 1) * windows.x + here.x + 1;
        state.x = -adjoint(gradients, at, windows.x, windows.x * windows.y, word);
        state.y = 1 / (diagonal(at, plane, windows.x, windows.x * windows.y, word) + push.damping);
        state.w = push.damping;
        z = state.y * state.x;
        rz += state.x * z;
      }
      solver_states[(here.z * box_extent.y + here.y) * box_extent.x + here.x] = state;
    }
    searches[cell] = vec2(z, 0);
  }
  float total = workgroup_sum(vec4(rz, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[gl_WorkGroupID.x] = total;
  }
}
