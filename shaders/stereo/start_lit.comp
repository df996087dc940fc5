#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "start.glsl"

// Where a pattern lights a pixel of a view (gl_WorkGroupID.y) in some slot of a window: a bit for the window around each of up to 32
// slots.

uniform samplerBuffer left;  // [t][y][x] grey value, below 0: none
uniform samplerBuffer right;
writeonly buffer Lit {
  uint lit[];  // [view][y][x]
};

void main() {
  uvec2 block = block_of(uint(pixels()));
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    uint own = 0;
    for (int t = 0; t < push.volume.z; ++t) {
      int voxel = t * pixels() + int(i);
      float grey = gl_WorkGroupID.y == 0 ? texelFetch(left, voxel).x : texelFetch(right, voxel).x;
      own |= grey >= push.least_grey ? 1u << t : 0;
    }
    uint bits = own;
    for (int k = 1; k <= push.reach; ++k) {
      bits |= own << k | own >> k;
    }
    lit[gl_WorkGroupID.y * pixels() + i] = bits;
  }
}
