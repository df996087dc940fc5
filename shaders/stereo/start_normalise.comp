#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "start.glsl"

// Takes mean and contrast of the surroundings (17 x 7 px) out of the pictures of a window, so that gain and bias of either camera do
// not count. A workgroup: 64 pixels of a row (x, y) of one view of one slot of the chunk (z).

uniform samplerBuffer left;  // [t][y][x] grey value, below 0: none
uniform samplerBuffer right;
uniform usamplerBuffer lit;  // [view][y][x] a bit a slot
writeonly buffer Normalised {
  uint normalised[];  // [chunk][window][view][y][x] 1 to 255: 128 + 48 standard deviations; 0: nothing
};

const int kReachX = 8;
const int kReachY = 3;
const float kLeastContrast = 0.01;
const float kScale = 48;

shared vec3 columns[kGroupSize + 2 * kReachX];  // of 7 pixels: how many, sum, sum of squares

void main() {
  int image = int(gl_WorkGroupID.z);
  int view = image % 2;
  int near = image / 2 % window();
  int in_chunk = image / 2 / window();
  int centre = centre_of(in_chunk);
  int slot = centre + near - push.reach;
  if (centre < 0 || !speaks(slot)) {
    return;
  }
  int row = int(gl_WorkGroupID.y);
  int first = int(gl_WorkGroupID.x * kGroupSize);
  for (int at = int(gl_LocalInvocationID.x); at < int(kGroupSize) + 2 * kReachX; at += int(kGroupSize)) {
    int x = first + at - kReachX;
    vec3 sum = vec3(0);
    for (int y = max(row - kReachY, 0); y <= min(row + kReachY, push.volume.y - 1) && x >= 0 && x < push.volume.x; ++y) {
      int pixel = y * push.volume.x + x;
      float grey = view == 0 ? texelFetch(left, slot * pixels() + pixel).x : texelFetch(right, slot * pixels() + pixel).x;
      if (grey >= 0 && (texelFetch(lit, view * pixels() + pixel).x >> centre & 1u) != 0) {
        sum += vec3(1, grey, grey * grey);
      }
    }
    columns[at] = sum;
  }
  barrier();
  int x = first + int(gl_LocalInvocationID.x);
  if (x < push.volume.x) {
    vec3 sum = vec3(0);
    for (int k = 0; k <= 2 * kReachX; ++k) {
      sum += columns[int(gl_LocalInvocationID.x) + k];
    }
    int pixel = row * push.volume.x + x;
    float grey = view == 0 ? texelFetch(left, slot * pixels() + pixel).x : texelFetch(right, slot * pixels() + pixel).x;
    uint value = 0;
    if (grey >= 0 && (texelFetch(lit, view * pixels() + pixel).x >> centre & 1u) != 0) {
      float mean = sum.y / sum.x;
      float contrast = sqrt(max(sum.z / sum.x - mean * mean, 0));
      value = contrast >= kLeastContrast ? uint(clamp(128 + kScale * (grey - mean) / contrast, 1, 255)) : 0;
    }
    normalised[image_of(in_chunk, near, view) + pixel] = value;
  }
}
