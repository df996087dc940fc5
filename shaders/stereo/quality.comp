#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "windows.glsl"
#include "inverse4.glsl"

// How well each disparity is known: its standard deviation from the window's Hessian, the match's residual and what
// the window smooths away (docs/stereo.md, S10), and the correlation of the pictures over the window.

uniform samplerBuffer sums_xy;
uniform samplerBuffer disparities;
uniform usamplerBuffer links;
writeonly buffer Qualities {
  vec2 qualities[];  // [t][y][x] of the volume: standard deviation, px, 0 where nothing is known; correlation
};

#include "normal_equations.glsl"

void main() {
  ivec3 windows = window_extent();
  ivec2 cells = cells_of(box_extent, box_origin.z);
  for (int at = cells.x + int(gl_LocalInvocationID.x); at < cells.y; at += int(kGroupSize)) {
    ivec3 cell = cell_at(at, box_extent);
    int voxel = voxel_of(box_origin + cell);
    Window window = window_of(((cell.z + 1) * windows.y + cell.y + 1) * windows.x + cell.x + 1, voxel, box_origin.z + cell.z);
    vec2 quality = vec2(0);
    if (window.correlation > 0) {
      // J is weighted by 1 / variance, so that its inverse is the parameters' covariance.
      vec4 column = solve4(window.j_first, window.j_second, window.j_third, push.damping, vec4(1, 0, 0, 0));
      quality = vec2(sqrt(max(column.x, 0) + window.bias_square), window.correlation);
    }
    qualities[voxel] = quality;
  }
}
