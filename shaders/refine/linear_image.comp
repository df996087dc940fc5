#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// 8-bit sRGB to linear light for the region that the face needs, at full, half and quarter size: each invocation makes a block of
// 4x4 pixels. Alpha says whether the pixel can be trusted: 0 where a channel is saturated. Sources larger than any mesh can use
// are averaged down on the way.

layout(local_size_x = 8, local_size_y = 8) in;

layout(std140) uniform Frame {
  FrameParameters frame;
};
uniform samplerBuffer pixels;  // [height][width], as uploaded
layout(rgba16f) uniform writeonly image2D linear_image;
layout(rgba16f) uniform writeonly image2D half_image;
layout(rgba16f) uniform writeonly image2D quarter_image;

// A sensor's or codec's clipping begins a little below 255.
const float kSaturated = 250.5 / 255;

// ((s + 0.055) / 1.055)^2.4 between 0.039 and 1, within 4e-5 of itself: software devices take a power apart into a logarithm
// and an exponential, which cost several times as much.
vec3 power_of_srgb(vec3 s) {
  vec3 p = vec3(0.155165262);
  p = p * s - 0.581208752;
  p = p * s + 0.931905492;
  p = p * s - 0.908732370;
  p = p * s + 0.885601078;
  p = p * s + 0.480796875;
  p = p * s + 0.0356640282;
  return p * s + 0.000845298034;
}

vec4 linear_light(ivec2 at) {
  vec3 sum = vec3(0);
  float brightest = 0;
  ivec2 first = at * frame.reduction;
  for (int y = 0; y < frame.reduction; ++y) {
    for (int x = 0; x < frame.reduction; ++x) {
      // The linear image may be larger than the source by less than a block: its edge goes on.
      ivec2 from = min(first + ivec2(x, y), frame.source_px.xy - 1);
      vec3 srgb = texelFetch(pixels, from.y * frame.source_px.x + from.x).rgb;
      sum += mix(power_of_srgb(srgb), srgb * (1 / 12.92), lessThanEqual(srgb, vec3(0.04045)));
      brightest = max(brightest, max(max(srgb.r, srgb.g), srgb.b));
    }
  }
  float count = float(frame.reduction * frame.reduction);
  return vec4(sum / count, brightest < kSaturated ? 1 : 0);
}

void main() {
  ivec2 block = frame.region_px.xy + kImageBlockPx * ivec2(gl_GlobalInvocationID.xy);
  if (block.x >= frame.region_px.z || block.y >= frame.region_px.w) {
    return;
  }
  vec4 of_block = vec4(0);
  for (int quad_y = 0; quad_y < kImageBlockPx; quad_y += 2) {
    for (int quad_x = 0; quad_x < kImageBlockPx; quad_x += 2) {
      ivec2 quad = block + ivec2(quad_x, quad_y);
      vec4 of_quad = vec4(0);
      for (int y = 0; y < 2; ++y) {
        for (int x = 0; x < 2; ++x) {
          vec4 seen = linear_light(quad + ivec2(x, y));
          imageStore(linear_image, quad + ivec2(x, y), seen);
          of_quad += 0.25 * seen;
        }
      }
      imageStore(half_image, quad / 2, of_quad);
      of_block += 0.25 * of_quad;
    }
  }
  imageStore(quarter_image, block / 4, of_block);
}
