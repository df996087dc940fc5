#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "windows.glsl"
#include "inverse4.glsl"

// How well each disparity is known: its standard deviation from the window's Hessian and the match's residual, and
// the correlation of the pictures over the window.

uniform samplerBuffer sums_xy;
uniform samplerBuffer disparities;
uniform usamplerBuffer links;
writeonly buffer Qualities {
  vec2 qualities[];  // [t][y][x] of the volume: standard deviation, px, 0 where nothing is known; correlation
};

#include "normal_equations.glsl"

void main() {
  ivec3 windows = window_extent();
  ivec2 rows = rows_of(push.extent.y * push.extent.z);
  for (int row = rows.x; row < rows.y; ++row) {
    int y = row % push.extent.y;
    int t = row / push.extent.y;
    for (int i = int(gl_LocalInvocationID.x); i < push.extent.x; i += int(kGroupSize)) {
      int voxel = voxel_of(push.origin.xyz + ivec3(i, y, t));
      Window window = window_of(((t + 1) * windows.y + y + 1) * windows.x + i + 1, voxel);
      vec2 quality = vec2(0);
      if (window.correlation > 0) {
        // J is weighted by 1 / variance, so that its inverse is the parameters' covariance.
        vec4 column = solve4(window.j_first, window.j_second, window.j_third, push.damping, vec4(1, 0, 0, 0));
        quality = vec2(sqrt(max(column.x, 0)), window.correlation);
      }
      qualities[voxel] = quality;
    }
  }
}
