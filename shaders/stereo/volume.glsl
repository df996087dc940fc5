// The unknowns of a volume are a list; what concerns one of them alone goes over the list. The sums of their windows lie in boxes, one
// around the unknowns of each band of rows.

layout(push_constant) uniform Push {
  SolvePush push;
};

// First and past-the-end of this workgroup's items: contiguous runs, each walked in one loop. A loop over rows with one over a row's
// few cells in it leaves most lanes of a CPU's vectors idle at the end of every row.
ivec2 run_of(int first, int past) {
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

// Where a cell is in its box.
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
uint axis_bits(uint word, int axis) { return (word >> (4 * axis)) & 15u; }

// What a difference quotient divides by: central where both neighbours are there, one-sided where one is, 0
// where none is [SF04 eq. 6].
float quotient(uint bits) {
  uint both = bits & 3u;
  return both == 3u ? 0.5 : both == 0u ? 0.0 : 1.0;
}
