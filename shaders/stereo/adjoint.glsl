// [I; Gx; Gy; Gt]^T of a vector of windows: the part of one axis at a window. bits: of the axis at that voxel.
float adjoint_own(float own, uint bits) {
  uint both = bits & 3u;
  return both == kLinkAfter ? -own : both == kLinkBefore ? own : 0;
}
float adjoint_before(uint bits) { return (bits & kLinkBefore) == 0 ? 0 : (bits & kBeforeHasBefore) != 0 ? 0.5 : 1; }
float adjoint_after(uint bits) { return (bits & kLinkAfter) == 0 ? 0 : (bits & kAfterHasAfter) != 0 ? -0.5 : -1; }

float adjoint(samplerBuffer vectors, int at, ivec4 unknown) {
  Neighbours near = neighbours_of(at, unknown);
  vec4 own = texelFetch(vectors, at);
  uint word = uint(unknown.y);
  uint x = axis_bits(word, 0);
  uint y = axis_bits(word, 1);
  uint t = axis_bits(word, 2);
  float sum = own.x + adjoint_own(own.y, x) + adjoint_own(own.z, y) + adjoint_own(own.w, t);
  sum += adjoint_before(x) * texelFetch(vectors, near.before.x).y + adjoint_after(x) * texelFetch(vectors, near.after.x).y;
  sum += adjoint_before(y) * texelFetch(vectors, near.before.y).z + adjoint_after(y) * texelFetch(vectors, near.after.y).z;
  sum += adjoint_before(t) * texelFetch(vectors, near.before.z).w + adjoint_after(t) * texelFetch(vectors, near.after.z).w;
  return sum;
}
