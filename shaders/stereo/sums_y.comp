#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "bands.glsl"
#include "windows.glsl"

// Window sums along y of the sums along x, with powers of v = y - y0.

uniform samplerBuffer sums_x;  // [band][5][t][y][x]
writeonly buffer SumsXY {
  vec4 sums_xy[];  // [band][7][t][y][x]
};

void main() {
  ivec3 extent = box_extent();
  int margin = 2 * radius_y * extent.x;
  int plane = extent.x * extent.y * extent.z;
  int source_plane = plane + margin * extent.z;
  ivec2 cells = cells_of(extent);
  for (int cell = cells.x + int(gl_LocalInvocationID.x); cell < cells.y; cell += int(kGroupSize)) {
    int first = 5 * band.places.z + cell + margin * divided(cell, extent.x * extent.y).x;
    vec4 a = vec4(0);  // 1, l, w, ll
    vec4 b = vec4(0);  // lw, ww, hd, hdw
    vec4 c = vec4(0);  // h, hu, hv, hhdd
    vec4 e = vec4(0);  // hw, hwu, hwv, hl
    vec4 g = vec4(0);  // hlu, hlv, hhd, hhdu
    vec4 p = vec4(0);  // hhdv, hh, hhu, hhv
    vec3 q = vec3(0);  // hhuu, hhuv, hhvv
    for (int k = 0; k <= 2 * radius_y; ++k) {
      int from = first + k * extent.x;
      float v = float(k - radius_y);
      a += texelFetch(sums_x, from);
      b += texelFetch(sums_x, from + source_plane);
      vec4 linear = texelFetch(sums_x, from + 2 * source_plane);
      vec4 mixed = texelFetch(sums_x, from + 3 * source_plane);
      vec4 square = texelFetch(sums_x, from + 4 * source_plane);
      float hhv = square.x * v;
      c += vec4(linear.xy, linear.x * v, square.w);
      e += vec4(linear.zw, linear.z * v, mixed.x);
      g += vec4(mixed.y, mixed.x * v, mixed.zw);
      p += vec4(mixed.z * v, square.xy, hhv);
      q += vec3(square.z, square.y * v, hhv * v);
    }
    int to = 7 * band.places.w + cell;
    sums_xy[to] = a;
    sums_xy[to + plane] = b;
    sums_xy[to + 2 * plane] = c;
    sums_xy[to + 3 * plane] = e;
    sums_xy[to + 4 * plane] = g;
    sums_xy[to + 5 * plane] = p;
    sums_xy[to + 6 * plane] = vec4(q, 0);
  }
}
