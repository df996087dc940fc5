// Needs: positions, normals, ring_indices, topology.glsl.

// n*_i of [MD19 eq. 5] for a vertex with a closed ring, not normalised. sum: of the ring's displacements.
vec3 displaced_normal(ivec2 ring, vec3 centre, out float sum) {
  int size = ring_size(ring);
  int first = 4 * ring.x;
  int j = texelFetch(ring_indices, first).x;
  vec4 neighbour = texelFetch(positions, j);
  vec3 to_first = neighbour.xyz + neighbour.w * texelFetch(normals, j).xyz - centre;
  vec3 to_next = to_first;
  vec3 star = vec3(0);
  sum = neighbour.w;
  for (int k = 1; k < size; ++k) {
    vec3 to_this = to_next;
    j = texelFetch(ring_indices, first + k).x;
    neighbour = texelFetch(positions, j);
    to_next = neighbour.xyz + neighbour.w * texelFetch(normals, j).xyz - centre;
    star += cross(to_this, to_next);
    sum += neighbour.w;
  }
  return star + cross(to_next, to_first);
}

vec3 displaced_unit_normal(ivec2 ring, vec3 centre) {
  float sum;
  vec3 star = displaced_normal(ring, centre, sum);
  return star * inversesqrt(max(dot(star, star), 1e-30));
}
