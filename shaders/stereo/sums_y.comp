#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "windows.glsl"

// Window sums along y of the sums along x, with powers of v = y - y0.

uniform samplerBuffer sums_x;  // [5][t][y][x]
writeonly buffer SumsXY {
  vec4 sums_xy[];  // [7][t][y][x]
};

void main() {
  ivec3 extent = window_extent() + ivec3(0, 0, 2 * radius_t);
  int height = extent.y + 2 * radius_y;
  int plane = extent.x * extent.y * extent.z;
  int source_plane = extent.x * height * extent.z;
  ivec2 rows = rows_of(extent.y * extent.z);
  for (int row = rows.x; row < rows.y; ++row) {
    int first_row = row / extent.y * height + row % extent.y;
    for (int i = int(gl_LocalInvocationID.x); i < extent.x; i += int(kGroupSize)) {
      vec4 a = vec4(0);  // 1, l, w, ll
      vec4 b = vec4(0);  // lw, ww, hd, hdw
      vec4 c = vec4(0);  // h, hu, hv, hhdd
      vec4 e = vec4(0);  // hw, hwu, hwv, hl
      vec4 g = vec4(0);  // hlu, hlv, hhd, hhdu
      vec4 p = vec4(0);  // hhdv, hh, hhu, hhv
      vec3 q = vec3(0);  // hhuu, hhuv, hhvv
      for (int k = 0; k <= 2 * radius_y; ++k) {
        int from = (first_row + k) * extent.x + i;
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
      int at = row * extent.x + i;
      sums_xy[at] = a;
      sums_xy[at + plane] = b;
      sums_xy[at + 2 * plane] = c;
      sums_xy[at + 3 * plane] = e;
      sums_xy[at + 4 * plane] = g;
      sums_xy[at + 5 * plane] = p;
      sums_xy[at + 6 * plane] = vec4(q, 0);
    }
  }
}
