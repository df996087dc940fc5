#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "bands.glsl"
#include "unknowns.glsl"
#include "windows.glsl"
#include "inverse4.glsl"

// What was found, and how well each disparity is known: its standard deviation from the window's Hessian, the match's
// residual and what the window smooths away (docs/stereo.md, S10), and the correlation of the pictures over the window.

uniform samplerBuffer sums_xy;      // [band][7][t][y][x]
uniform samplerBuffer disparities;  // [t][y][x] px
writeonly buffer Found {
  vec4 found[];  // disparity, px; its standard deviation, px, 0 where nothing is known; correlation; -
};

#include "normal_equations.glsl"

void main() {
  ivec2 run = unknowns_of_band();
  for (int at = run.x + int(gl_LocalInvocationID.x); at < run.y; at += int(kGroupSize)) {
    ivec4 unknown = texelFetch(unknowns, at);
    ivec3 place = place_of(unknown);
    Window window = window_of(place, uint(unknown.y));
    vec4 here = vec4(texelFetch(disparities, voxel_of(place)).x, 0, 0, 0);
    if (window.correlation > 0) {
      // J is weighted by 1 / variance, so that its inverse is the parameters' covariance.
      vec4 column = solve4(window.j_first, window.j_second, window.j_third, push.damping, vec4(1, 0, 0, 0));
      here.yz = vec2(sqrt(max(column.x, 0) + window.bias_square), window.correlation);
    }
    found[at] = here;
  }
}
