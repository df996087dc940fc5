#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "windows.glsl"

// J and b of every window of a block [SF04 eq. 5, 7]: the sums along t, then gain and bias taken out.

uniform samplerBuffer sums_xy;      // [7][t][y][x]
uniform samplerBuffer disparities;  // [t][y][x] px
uniform usamplerBuffer links;       // [t][y][x]
writeonly buffer Hessians {
  vec4 hessians[];  // [3][t][y][x] J00 J01 J02 J03, J11 J12 J13 J22, J23 J33 - -
};
writeonly buffer Gradients {
  vec4 gradients[];  // [t][y][x] b
};
writeonly buffer Energies {
  float energies[];  // [slot][workgroup]
};

#include "normal_equations.glsl"

void main() {
  ivec3 extent = window_extent();
  ivec3 origin = window_origin();
  int plane = extent.x * extent.y * extent.z;
  ivec2 cells = cells_of(extent, origin.z);
  float energy = 0;
  for (int at = cells.x + int(gl_LocalInvocationID.x); at < cells.y; at += int(kGroupSize)) {
    ivec3 cell = cell_at(at, extent);
    ivec3 here = origin + cell;
    Window window = no_window();
    if (inside(here)) {
      window = window_of(at, voxel_of(here), here.z);
    }
    hessians[at] = window.j_first;
    hessians[at + plane] = window.j_second;
    hessians[at + 2 * plane] = vec4(window.j_third, 0, 0);
    gradients[at] = window.b;
    bool in_block = all(greaterThan(cell, ivec3(0))) && all(lessThan(cell, extent - 1));
    energy += in_block ? window.energy : 0;
  }
  float total = workgroup_sum(vec4(energy, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    energies[push.energy_slot * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
