#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "bspline.glsl"

// Resamples a picture into a slot of a volume through the cubic B-spline. Grey values 0 to 1, as coded;
// -1 where the picture does not reach or is saturated, and in slots that say nothing.

layout(push_constant) uniform Push {
  RectifyPush push;
};
uniform samplerBuffer picture;  // [height][width] RGBA
uniform samplerBuffer sources;  // [height][width] of the volume: where in the picture, px; below 0: nowhere
readonly buffer Usable {
  float usable[];  // [slots] 0: the slot has no picture, or none with a pattern
};
writeonly buffer Grey {
  float grey[];
};

void main() {
  uint count = uint(push.size.z * push.size.w);
  uvec2 block = block_of(count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    vec2 at = texelFetch(sources, int(i)).xy;
    float value = -1;
    ivec2 corner = ivec2(floor(at));
    if (usable[push.slot] > 0 && corner.x >= 1 && corner.y >= 1 && corner.x + 2 < push.size.x && corner.y + 2 < push.size.y) {
      vec4 across = bspline(at.x - float(corner.x));
      vec4 down = bspline(at.y - float(corner.y));
      float brightest = 0;
      float sum = 0;
      for (int y = 0; y < 4; ++y) {
        float line = 0;
        for (int x = 0; x < 4; ++x) {
          vec3 colour = texelFetch(picture, (corner.y - 1 + y) * push.size.x + corner.x - 1 + x).rgb;
          float tap = (colour.r + colour.g + colour.b) * (1.0 / 3.0);
          line += across[x] * tap;
          brightest = max(brightest, tap);
        }
        sum += down[y] * line;
      }
      value = brightest < push.saturated ? clamp(sum, 0, 1) : -1;
    }
    grey[push.slot * int(count) + int(i)] = value;
  }
}
