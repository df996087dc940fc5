// The list of unknowns (layout.h).

uniform isamplerBuffer unknowns;

ivec3 place_of(ivec4 unknown) {
  uint packed = uint(unknown.x);
  return ivec3(packed & (kMost_px - 1), (packed / kMost_px) & (kMost_px - 1), packed / (kMost_px * kMost_px));
}

// Its neighbours in the list; itself where there is no link.
struct Neighbours {
  ivec3 before;
  ivec3 after;
};

Neighbours neighbours_of(int at, ivec4 unknown) {
  uint x = uint(unknown.y);
  uvec2 y = uvec2(unknown.zw) & ((1u << kAlongYBits) - 1);
  uvec2 t = uvec2(unknown.zw) >> kAlongYBits;
  return Neighbours(at - ivec3(x & 1u, y.x, t.x), at + ivec3((x >> 1) & 1u, y.y, t.y));
}
