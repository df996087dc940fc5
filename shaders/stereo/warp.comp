#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "bands.glsl"
#include "windows.glsl"
#include "bspline.glsl"

// The samples of all windows of a band: the left picture, the right one at x - d, both blurred by the cubic
// B-spline, and how the right one changes with d.

uniform samplerBuffer left;         // [t][y][x] grey value, below 0: none
uniform samplerBuffer right;        // the same
uniform samplerBuffer disparities;  // [t][y][x] px
writeonly buffer Samples {
  vec4 samples[];  // l - 1/2, w - 1/2, h = dw/dd, d
};

void main() {
  ivec3 margin = ivec3(radius_x, radius_y, 0);
  ivec3 extent = box_extent() + 2 * margin;
  ivec3 origin = box_origin() - margin;
  ivec2 cells = cells_of(extent);
  for (int cell = cells.x + int(gl_LocalInvocationID.x); cell < cells.y; cell += int(kGroupSize)) {
    vec4 sample_here = vec4(0, 0, 0, kNoSample);
    ivec3 at = origin + cell_at(cell, extent);
    if (inside(at) && at.x > 0 && at.x + 1 < push.volume.x) {
      int voxel = voxel_of(at);
      float l = texelFetch(left, voxel).x;
      float d = texelFetch(disparities, voxel).x;
      if (l >= 0 && d > kNoDisparity) {
        float from = float(at.x) - d;
        int corner = int(floor(from));
        if (corner >= 1 && corner + 2 < push.volume.x) {
          float f = from - float(corner);
          int first = voxel - at.x + corner - 1;
          vec4 taps = vec4(texelFetch(right, first).x, texelFetch(right, first + 1).x, texelFetch(right, first + 2).x,
                           texelFetch(right, first + 3).x);
          vec2 beside = vec2(texelFetch(left, voxel - 1).x, texelFetch(left, voxel + 1).x);
          if (min(min(min(taps.x, taps.y), min(taps.z, taps.w)), min(beside.x, beside.y)) >= 0) {
            // Both pictures through the same blur.
            float own = (beside.x + 4 * l + beside.y) * (1.0 / 6.0);
            sample_here = vec4(own - 0.5, dot(bspline(f), taps) - 0.5, -dot(bspline_slope(f), taps), d);
          }
        }
      }
    }
    samples[band.extent.w + cell] = sample_here;
  }
}
