// Regions of a block, each one [t][y][x]: the box around its unknowns; the box's windows (one voxel more on each side, since the slopes
// of a border voxel reach into the box); the search vector (two more); the samples (the windows' reach).
// The cells of a region are spread over the workgroups in contiguous runs, each walked in one loop: a loop over rows
// with one over the row's few cells in it leaves most lanes of a CPU's vectors idle at the end of every row. Cells in
// slots that the volume does not have are left out; nothing reads them but with the weight 0.

layout(push_constant) uniform Push {
  BlockPush push;
};
readonly buffer Boxes {
  ivec4 boxes[];  // [block] of the unknowns of a block: first voxel, then voxels; 0 voxels where there are none
};

ivec3 box_origin = boxes[2 * push.block].xyz;
ivec3 box_extent = boxes[2 * push.block + 1].xyz;

ivec3 window_extent() { return box_extent + 2; }
ivec3 window_origin() { return box_origin - 1; }
ivec3 search_extent() { return box_extent + 4; }

// First and past-the-end cell of this workgroup, of a region whose first cell lies in the slot first_slot.
ivec2 cells_of(ivec3 extent, int first_slot) {
  int slice = extent.x * extent.y;
  int first = max(0, -first_slot) * slice;
  int past = clamp(push.volume.z - first_slot, 0, extent.z) * slice;
  int stride = int(gl_NumWorkGroups.x * kGroupSize);
  int size = (max(past - first, 0) + stride - 1) / stride * int(kGroupSize);
  int begin = first + int(gl_WorkGroupID.x) * size;
  return ivec2(begin, min(begin + size, past));
}

// Quotient and remainder by the reciprocal: CPUs have no vectors of integer divisions. One off by rounding is put right.
ivec2 divided(int value, int by) {
  int quotient = int(float(value) * (1.0 / float(by)));
  int rest = value - quotient * by;
  int off = rest < 0 ? -1 : rest >= by ? 1 : 0;
  return ivec2(quotient + off, rest - off * by);
}

// Where a cell is in its region.
ivec3 cell_at(int cell, ivec3 extent) {
  ivec2 row = divided(cell, extent.x);
  ivec2 slice = divided(row.x, extent.y);
  return ivec3(row.y, slice.y, slice.x);
}

bool inside(ivec3 at) {
  return all(greaterThanEqual(at, ivec3(0))) && all(lessThan(at, push.volume.xyz));
}
int voxel_of(ivec3 at) { return (at.z * push.volume.y + at.y) * push.volume.x + at.x; }

// The four bits of an axis.
uint axis_bits(uint word, int axis) { return (word >> (1 + 4 * axis)) & 15u; }

// What a difference quotient divides by: central where both neighbours are there, one-sided where one is, 0
// where none is [SF04 eq. 6].
float quotient(uint bits) {
  uint both = bits & 3u;
  return both == 3u ? 0.5 : both == 0u ? 0.0 : 1.0;
}
