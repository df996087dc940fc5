#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "bands.glsl"
#include "windows.glsl"

// Window sums along x of all products that the normal equations need, with powers of u = x - x0.

uniform samplerBuffer samples;  // [t][y][x] l, w, h, d
writeonly buffer SumsX {
  vec4 sums_x[];  // [band][5][t][y][x]
};

void main() {
  ivec3 extent = box_extent() + ivec3(0, 2 * radius_y, 0);
  int plane = extent.x * extent.y * extent.z;
  ivec2 cells = cells_of(extent);
  for (int cell = cells.x + int(gl_LocalInvocationID.x); cell < cells.y; cell += int(kGroupSize)) {
    int first = band.extent.w + cell + 2 * radius_x * divided(cell, extent.x).x;
    vec4 a = vec4(0);  // 1, l, w, ll
    vec4 b = vec4(0);  // lw, ww, hd, hdw
    vec4 c = vec4(0);  // h, hu, hw, hwu
    vec4 e = vec4(0);  // hl, hlu, hhd, hhdu
    vec4 g = vec4(0);  // hh, hhu, hhuu, hhdd
    for (int k = -radius_x; k <= radius_x; ++k) {
      vec4 s = texelFetch(samples, first + radius_x + k);
      float u = float(k);
      float hw = s.z * s.y;
      float hl = s.z * s.x;
      float hh = s.z * s.z;
      float hd = s.z * s.w;
      float hhu = hh * u;
      float hhd = hd * s.z;
      a += vec4(s.w > 0.5 * kNoSample ? 1 : 0, s.x, s.y, s.x * s.x);
      b += vec4(s.x * s.y, s.y * s.y, hd, hd * s.y);
      c += vec4(s.z, s.z * u, hw, hw * u);
      e += vec4(hl, hl * u, hhd, hhd * u);
      g += vec4(hh, hhu, hhu * u, hd * hd);
    }
    int to = 5 * band.places.z + cell;
    sums_x[to] = a;
    sums_x[to + plane] = b;
    sums_x[to + 2 * plane] = c;
    sums_x[to + 3 * plane] = e;
    sums_x[to + 4 * plane] = g;
  }
}
