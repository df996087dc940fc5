#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "start.glsl"

// The best disparity of each pixel of a row (x) of one slot of the chunk (y), checked against the best of the right picture's pixels.

uniform usamplerBuffer costs;   // [chunk][y][x][count / 4]
readonly buffer Totals {
  uint totals[];  // [chunk][y][x][count / 2]
};
uniform usamplerBuffer lit;     // [view][y][x] a bit a slot
writeonly buffer Found {
  float found[];  // [t][y][x] px; kNoDisparity: none
};

shared uint right_best[kMost_px];  // cost, disparity

uint total_of(int pixel, int k) {
  uint word = totals[pixel * (push.count / 2) + k / 2];
  return k % 2 == 0 ? word & 0xffffu : word >> 16;
}

void main() {
  int in_chunk = int(gl_WorkGroupID.y);
  int centre = centre_of(in_chunk);
  if (centre < 0) {
    return;
  }
  int width = push.volume.x;
  int row = int(gl_WorkGroupID.x) * width;
  int first = in_chunk * pixels() + row;
  for (int x = int(gl_LocalInvocationID.x); x < width; x += int(kGroupSize)) {
    right_best[x] = 0xffffffffu;
  }
  barrier();
  for (int x = int(gl_LocalInvocationID.x); x < width; x += int(kGroupSize)) {
    if ((texelFetch(lit, row + x).x >> centre & 1u) != 0) {
      for (int k = max(0, x - push.least_px - width + 1); k < min(push.used, x - push.least_px + 1); ++k) {
        atomicMin(right_best[x - push.least_px - k], total_of(first + x, k) << 16 | uint(k));
      }
    }
  }
  barrier();
  for (int x = int(gl_LocalInvocationID.x); x < width; x += int(kGroupSize)) {
    float out_px = kNoDisparity;
    if ((texelFetch(lit, row + x).x >> centre & 1u) != 0) {
      uint smallest = 0xffffffffu;
      int best = 0;
      for (int k = 0; k < push.used; ++k) {
        uint total = total_of(first + x, k);
        best = total < smallest ? k : best;
        smallest = min(smallest, total);
      }
      uint second = 0xffffu;
      for (int k = 0; k < push.used; ++k) {
        second = abs(k - best) > 1 ? min(second, total_of(first + x, k)) : second;
      }
      int there = x - push.least_px - best;
      uint cost = texelFetch(costs, (first + x) * (push.count / 4) + best / 4).x >> (8 * (best % 4)) & 255u;
      if (there >= 0 && there < width && cost <= uint(push.most_cost) && abs(int(right_best[there] & 0xffffu) - best) <= 1 &&
          float(second) >= (1 + push.uniqueness) * float(smallest)) {
        float fraction = 0;
        if (best > 0 && best + 1 < push.used) {
          float before = float(total_of(first + x, best - 1));
          float after = float(total_of(first + x, best + 1));
          float bend = before - 2 * float(smallest) + after;
          fraction = bend > 0 ? (before - after) / (2 * bend) : 0;
        }
        out_px = float(push.least_px + best) + fraction;
      }
    }
    found[centre * pixels() + row + x] = out_px;
  }
}
