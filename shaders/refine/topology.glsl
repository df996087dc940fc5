// The one-rings of a level (mesh::OneRings). Vertex i has vertex_rings[i] = (first group, ring size | flags);
// its neighbours stand in ring_indices from four times that on, in counter-clockwise order.

const int kRingSizeMask = 0xffff;
const int kFree = 0x10000;    // refined by shading; others keep the displacement 0
const int kClosed = 0x20000;  // not on the boundary
const int kTrustShift = 20;   // above it, in 8 bits: how far what shades the skin there is its shape

int ring_size(ivec2 ring) {
  return ring.y & kRingSizeMask;
}
bool is_free(ivec2 ring) {
  return (ring.y & kFree) != 0;
}
// What shading says of a vertex's shape counts by this, 0 to 1.
float trust_in(ivec2 ring) {
  return float(ring.y >> kTrustShift) / 255;
}
bool is_closed(ivec2 ring) {
  return (ring.y & kClosed) != 0;
}
