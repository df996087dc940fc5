#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// The coarsest mips that observe reads, from the quarter image: each invocation makes one pixel of the last, and those of
// the two before that it covers, wherever the region touches it.

layout(local_size_x = 8, local_size_y = 4) in;

layout(std140) uniform Frame {
  FrameParameters frame;
};
uniform sampler2D quarter_image;
layout(rgba16f) uniform writeonly image2D eighth_image;
layout(rgba16f) uniform writeonly image2D sixteenth_image;
layout(rgba16f) uniform writeonly image2D smallest_image;

void main() {
  ivec2 tile = frame.region_px.xy / kImageTilePx + ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(kImageTilePx * tile, frame.region_px.zw))) {
    return;
  }
  vec4 of_tile = vec4(0);
  for (int part = 0; part < 4; ++part) {
    ivec2 sixteenth = 2 * tile + ivec2(part & 1, part >> 1);
    vec4 of_part = vec4(0);
    for (int k = 0; k < 4; ++k) {
      ivec2 eighth = 2 * sixteenth + ivec2(k & 1, k >> 1);
      ivec2 quarter = 2 * eighth;
      vec4 sum = texelFetch(quarter_image, quarter, 0) + texelFetch(quarter_image, quarter + ivec2(1, 0), 0) +
                 texelFetch(quarter_image, quarter + ivec2(0, 1), 0) + texelFetch(quarter_image, quarter + ivec2(1, 1), 0);
      imageStore(eighth_image, eighth, 0.25 * sum);
      of_part += 0.0625 * sum;
    }
    imageStore(sixteenth_image, sixteenth, of_part);
    of_tile += 0.25 * of_part;
  }
  imageStore(smallest_image, tile, of_tile);
}
