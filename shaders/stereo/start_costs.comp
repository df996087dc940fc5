#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "start.glsl"

// Costs of a match: absolute differences over 1 x 3 pixels and the slots of a window [SF04 eq. 2], four disparities a word. A
// workgroup: words of one slot of the chunk (y).

uniform usamplerBuffer normalised;  // [chunk][window][view][y][x]
writeonly buffer Costs {
  uint costs[];  // [chunk][y][x][count / 4]
};
writeonly buffer Totals {
  uint totals[];  // [chunk][y][x][count / 2], set to 0
};

const int kMostDifference = 128;
const int kUnknownCost = 48;

void main() {
  int in_chunk = int(gl_WorkGroupID.y);
  int centre = centre_of(in_chunk);
  if (centre < 0) {
    return;
  }
  int words = push.count / 4;
  int slots = 0;
  for (int near = 0; near < window(); ++near) {
    slots += speaks(centre + near - push.reach) ? 1 : 0;
  }
  // Division by 3 slots as a multiplication: the quotient is at most 128.
  int scale = 65536 / (3 * max(slots, 1));
  int first_word = in_chunk * pixels() * words;
  uvec2 block = block_of(uint(pixels() * words));
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    int pixel = int(i) / words;
    int k = 4 * (int(i) - pixel * words);
    int x = pixel % push.volume.x;
    int row = pixel - x;
    ivec4 sums = ivec4(0);
    for (int near = 0; near < window(); ++near) {
      if (!speaks(centre + near - push.reach)) {
        continue;
      }
      int left = image_of(in_chunk, near, 0) + row;
      int right = image_of(in_chunk, near, 1) + row;
      for (int beside = -1; beside <= 1; ++beside) {
        int at = clamp(x + beside, 0, push.volume.x - 1);
        int own = int(texelFetch(normalised, left + at).x);
        for (int d = 0; d < 4; ++d) {
          int there = at - push.least_px - k - d;
          int other = there >= 0 && there < push.volume.x ? int(texelFetch(normalised, right + there).x) : 0;
          sums[d] += own == 0 ? kUnknownCost : other == 0 ? kMostDifference : min(abs(own - other), kMostDifference);
        }
      }
    }
    uint word = 0;
    for (int d = 0; d < 4; ++d) {
      uint cost = k + d < push.used ? uint(sums[d] * scale) >> 16 : 255;
      word |= cost << (8 * d);
    }
    costs[first_word + int(i)] = word;
    totals[2 * (first_word + int(i))] = 0;
    totals[2 * (first_word + int(i)) + 1] = 0;
  }
}
