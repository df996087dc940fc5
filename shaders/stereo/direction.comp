#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "common/pcg.glsl"
#include "volume.glsl"

// First half of a CG iteration of [SF04 eq. 9]: s = z + beta s, q = J [I; Gx; Gy; Gt] s at every window, where
// [Gx; Gy; Gt] s are differences [SF04 eq. 8], and s . A s as the sum of [I; G] s . q over the windows.

uniform samplerBuffer hessians;
uniform usamplerBuffer links;
uniform samplerBuffer searches;     // [t][y][x] of the search region
writeonly buffer Products {
  vec4 products[];  // [t][y][x] of the windows
};

float search_at(int at, float beta) {
  vec2 search = texelFetch(searches, at).xy;
  return search.x + beta * search.y;
}

float slope_of(int at, int stride, uint bits, float beta) {
  float before = search_at((bits & kLinkBefore) != 0 ? at - stride : at, beta);
  float after = search_at((bits & kLinkAfter) != 0 ? at + stride : at, beta);
  return (after - before) * quotient(bits);
}

void main() {
  float beta = pcg_beta(push.iteration);
  ivec3 extent = window_extent();
  ivec3 origin = window_origin();
  int plane = extent.x * extent.y * extent.z;
  int search_width = extent.x + 2;
  int search_slice = search_width * (extent.y + 2);
  ivec2 cells = cells_of(extent, origin.z);
  float curvature = 0;
  for (int at = cells.x + int(gl_LocalInvocationID.x); at < cells.y; at += int(kGroupSize)) {
    ivec3 cell = cell_at(at, extent);
    ivec3 here = origin + cell;
    vec4 q = vec4(0);
    if (inside(here)) {
      uint word = texelFetch(links, voxel_of(here)).x;
      int from = (cell.z + 1) * search_slice + (cell.y + 1) * search_width + cell.x + 1;
      float own = search_at(from, beta);
      vec4 s = vec4(own, slope_of(from, 1, axis_bits(word, 0), beta),
                    slope_of(from, search_width, axis_bits(word, 1), beta),
                    slope_of(from, search_slice, axis_bits(word, 2), beta));
      vec4 first = texelFetch(hessians, at);
      vec4 second = texelFetch(hessians, at + plane);
      vec2 third = texelFetch(hessians, at + 2 * plane).xy;
      q = vec4(dot(first, s), dot(vec4(first.y, second.xyz), s), dot(vec4(first.z, second.yw, third.x), s),
               dot(vec4(first.w, second.z, third), s));
      bool in_block = all(greaterThan(cell, ivec3(0))) && all(lessThan(cell, extent - 1));
      curvature += dot(s, q) + (in_block ? push.damping * own * own : 0);
    }
    products[at] = q;
  }
  float total = workgroup_sum(vec4(curvature, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 1) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
