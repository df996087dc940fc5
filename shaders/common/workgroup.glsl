// Workgroups that each walk over one contiguous block of the items, and sums over a workgroup and over all of
// them. Few workgroups with long blocks are fast on a CPU; on a GPU there are enough of them to fill it.
#include "common/workgroup_sum.glsl"

const uint kGroupSize = 64;
layout(local_size_x = 64) in;

// First and past-the-end item of this workgroup.
uvec2 block_of(uint item_count) {
  uint stride = kGroupSize * gl_NumWorkGroups.x;
  uint size = (item_count + stride - 1) / stride * kGroupSize;
  uint first = gl_WorkGroupID.x * size;
  return uvec2(first, min(first + size, item_count));
}
