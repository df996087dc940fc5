#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "inverse4.glsl"

// A Gauss-Newton step of local spacetime stereo (eq. 4): every voxel on its own, d, dx, dy and dt free.

uniform samplerBuffer hessians;
uniform samplerBuffer gradients;
uniform usamplerBuffer links;
buffer Disparities {
  float disparities[];
};

void main() {
  ivec3 windows = window_extent();
  int plane = windows.x * windows.y * windows.z;
  ivec2 rows = rows_of(push.extent.y * push.extent.z);
  for (int row = rows.x; row < rows.y; ++row) {
    int y = row % push.extent.y;
    int t = row / push.extent.y;
    for (int i = int(gl_LocalInvocationID.x); i < push.extent.x; i += int(kGroupSize)) {
      int voxel = voxel_of(push.origin.xyz + ivec3(i, y, t));
      int at = ((t + 1) * windows.y + y + 1) * windows.x + i + 1;
      if ((texelFetch(links, voxel).x & kSolved) != 0) {
        vec4 moved = solve4(texelFetch(hessians, at), texelFetch(hessians, at + plane),
                            texelFetch(hessians, at + 2 * plane).xy, push.damping, -texelFetch(gradients, at));
        disparities[voxel] += clamp(moved.x, -push.most_move_px, push.most_move_px);
      }
    }
  }
}
