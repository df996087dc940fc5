// Needs: positions, normals, ring_indices, topology.glsl.

// n*_i of [MD19 eq. 5] for a vertex with a closed ring, not normalised.
vec3 displaced_normal(ivec2 ring, vec3 centre) {
  int size = ring_size(ring);
  int first = 4 * ring.x;
  int j = texelFetch(ring_indices, first).x;
  vec4 neighbour = texelFetch(positions, j);
  vec3 to_first = neighbour.xyz + neighbour.w * texelFetch(normals, j).xyz - centre;
  vec3 to_next = to_first;
  vec3 star = vec3(0);
  for (int k = 1; k < size; ++k) {
    vec3 to_this = to_next;
    j = texelFetch(ring_indices, first + k).x;
    neighbour = texelFetch(positions, j);
    to_next = neighbour.xyz + neighbour.w * texelFetch(normals, j).xyz - centre;
    star += cross(to_this, to_next);
  }
  return star + cross(to_next, to_first);
}

vec3 displaced_unit_normal(ivec2 ring, vec3 centre) {
  vec3 star = displaced_normal(ring, centre);
  return star * inversesqrt(max(dot(star, star), 1e-30));
}
