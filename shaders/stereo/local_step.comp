#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "inverse4.glsl"

// A Gauss-Newton step of local spacetime stereo [SF04 eq. 4]: every voxel on its own, d, dx, dy and dt free.

uniform samplerBuffer hessians;
uniform samplerBuffer gradients;
uniform usamplerBuffer links;
buffer Disparities {
  float disparities[];
};

void main() {
  ivec3 windows = window_extent();
  int plane = windows.x * windows.y * windows.z;
  ivec2 cells = cells_of(box_extent, box_origin.z);
  for (int at = cells.x + int(gl_LocalInvocationID.x); at < cells.y; at += int(kGroupSize)) {
    ivec3 cell = cell_at(at, box_extent);
    int voxel = voxel_of(box_origin + cell);
    int window = ((cell.z + 1) * windows.y + cell.y + 1) * windows.x + cell.x + 1;
    if ((texelFetch(links, voxel).x & kSolved) != 0) {
      vec4 moved = solve4(texelFetch(hessians, window), texelFetch(hessians, window + plane),
                          texelFetch(hessians, window + 2 * plane).xy, push.damping, -texelFetch(gradients, window));
      disparities[voxel] += clamp(moved.x, -push.most_move_px, push.most_move_px);
    }
  }
}
