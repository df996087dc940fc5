// The one-rings of a level (mesh::OneRings). Vertex i has vertex_rings[i] = (first group, ring size | flags);
// its neighbours stand in ring_groups four to a group from there on, in counter-clockwise order, the last
// group filled up with the dummy vertex [vertex_count], whose values are 0.

const int kRingSizeMask = 0xffff;
const int kFree = 0x10000;    // refined by shading; others keep the displacement 0
const int kClosed = 0x20000;  // not on the boundary

int ring_size(ivec2 ring) {
  return ring.y & kRingSizeMask;
}
bool is_free(ivec2 ring) {
  return (ring.y & kFree) != 0;
}
bool is_closed(ivec2 ring) {
  return (ring.y & kClosed) != 0;
}
