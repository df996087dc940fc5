#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "bands.glsl"
#include "unknowns.glsl"
#include "windows.glsl"

// J and b of the window of every unknown of a band [SF04 eq. 5, 7]: the sums along t, then gain and bias taken out.

uniform samplerBuffer sums_xy;      // [band][7][t][y][x]
uniform samplerBuffer disparities;  // [t][y][x] px
writeonly buffer FirstRows {
  vec4 first_rows[];  // J00 J01 J02 J03 of every unknown
};
writeonly buffer SecondRows {
  vec4 second_rows[];  // J11 J12 J13 J22
};
writeonly buffer ThirdRows {
  vec2 third_rows[];  // J23 J33
};
writeonly buffer Gradients {
  vec4 gradients[];  // b
};
writeonly buffer Energies {
  float energies[];  // [step][band][workgroup]
};

#include "normal_equations.glsl"

void main() {
  ivec2 run = unknowns_of_band();
  float energy = 0;
  for (int at = run.x + int(gl_LocalInvocationID.x); at < run.y; at += int(kGroupSize)) {
    ivec4 unknown = texelFetch(unknowns, at);
    Window window = window_of(place_of(unknown), uint(unknown.y));
    first_rows[at] = window.j_first;
    second_rows[at] = window.j_second;
    third_rows[at] = window.j_third;
    gradients[at] = window.b;
    energy += window.energy;
  }
  float total = workgroup_sum(vec4(energy, 0, 0, 0)).x;
  if (band_here && gl_LocalInvocationID.x == 0) {
    energies[(push.step * gl_NumWorkGroups.y + gl_WorkGroupID.y) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
