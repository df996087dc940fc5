// Regions of a block, each one [t][y][x]: the block; its windows (one voxel more on each side, since the slopes
// of a border voxel reach into the block); the search vector (two more); the samples (the windows' reach).
// Rows of a region are spread over the workgroups, the voxels of a row over the invocations, so that no voxel
// costs a division.

layout(push_constant) uniform Push {
  BlockPush push;
};

ivec3 window_extent() { return push.extent.xyz + 2; }
ivec3 window_origin() { return push.origin.xyz - 1; }
ivec3 search_extent() { return push.extent.xyz + 4; }

// First and past-the-end row of this workgroup.
ivec2 rows_of(int row_count) {
  int size = (row_count + int(gl_NumWorkGroups.x) - 1) / int(gl_NumWorkGroups.x);
  int first = int(gl_WorkGroupID.x) * size;
  return ivec2(first, min(first + size, row_count));
}

bool inside(ivec3 at) {
  return all(greaterThanEqual(at, ivec3(0))) && all(lessThan(at, push.volume.xyz));
}
int voxel_of(ivec3 at) { return (at.z * push.volume.y + at.y) * push.volume.x + at.x; }

// The four bits of an axis.
uint axis_bits(uint word, int axis) { return (word >> (1 + 4 * axis)) & 15u; }

// What a difference quotient divides by: central where both neighbours are there, one-sided where one is, 0
// where none is (eq. 7).
float quotient(uint bits) {
  uint both = bits & 3u;
  return both == 3u ? 0.5 : both == 0u ? 0.0 : 1.0;
}
