#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// 8-bit sRGB to linear light for the region that the face needs. Alpha says whether the pixel can be
// trusted: 0 where a channel is saturated. Sources larger than any mesh can use are averaged down on the way.

layout(local_size_x = 64) in;

layout(std140) uniform Frame {
  FrameParameters frame;
};
uniform samplerBuffer pixels;  // [height][width], as uploaded
layout(rgba16f) uniform writeonly image2D linear_image;

// A sensor's or codec's clipping begins a little below 255.
const float kSaturated = 250.5 / 255;

void main() {
  ivec2 at = frame.region_px.xy + ivec2(gl_GlobalInvocationID.xy);
  if (at.x >= frame.region_px.z || at.y >= frame.region_px.w) {
    return;
  }
  vec3 sum = vec3(0);
  float brightest = 0;
  ivec2 first = at * frame.reduction;
  for (int y = 0; y < frame.reduction; ++y) {
    for (int x = 0; x < frame.reduction; ++x) {
      ivec2 from = min(first + ivec2(x, y), frame.source_px.xy - 1);
      vec3 srgb = texelFetch(pixels, from.y * frame.source_px.x + from.x).rgb;
      vec3 high = pow((srgb + 0.055) * (1 / 1.055), vec3(2.4));
      sum += mix(high, srgb * (1 / 12.92), lessThanEqual(srgb, vec3(0.04045)));
      brightest = max(brightest, max(max(srgb.r, srgb.g), srgb.b));
    }
  }
  float count = float(frame.reduction * frame.reduction);
  imageStore(linear_image, at, vec4(sum / count, brightest < kSaturated ? 1 : 0));
}
