#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require
#include "layout.h"
#include "start.glsl"

// Costs gathered along paths of eight directions (gl_WorkGroupID.y), a subgroup a path, its disparities over the lanes:
//   L(p, d) = C(p, d) + min(L(q, d), L(q, d -+ 1) + P1, min_k L(q, k) + P2) - min_k L(q, k), q before p
// Lanes beside each other meet in shared memory, within their subgroup: no barrier of the workgroup.

layout(constant_id = 0) const int lane_words = 1;  // words of four costs that a lane has
layout(constant_id = 1) const int lanes = 32;      // of a subgroup

const uint kGroupSize = 64;
layout(local_size_x = 64) in;

uniform usamplerBuffer costs;  // [chunk][y][x][count / 4]
buffer Totals {
  uint totals[];  // [chunk][y][x][count / 2] sums over the paths, two a word
};

const uint kForbidden = 0x7000;

shared uint edges[2][kGroupSize];  // a lane's first and last L

void main() {
  int in_chunk = int(gl_WorkGroupID.z);
  if (centre_of(in_chunk) < 0) {
    return;
  }
  int width = push.volume.x;
  int height = push.volume.y;
  int lane = int(gl_LocalInvocationID.x) % lanes;
  int path = int(gl_WorkGroupID.x) * (int(kGroupSize) / lanes) + int(gl_LocalInvocationID.x) / lanes;
  const ivec2 directions[8] = {ivec2(1, 0), ivec2(-1, 0), ivec2(0, 1), ivec2(0, -1),
                               ivec2(1, 1), ivec2(-1, 1), ivec2(1, -1), ivec2(-1, -1)};
  ivec2 step_px = directions[gl_WorkGroupID.y];
  // Paths begin at the side that the direction comes from, diagonal ones at two.
  ivec2 sides = ivec2(step_px.x > 0 ? 0 : width - 1, step_px.y > 0 ? 0 : height - 1);
  ivec2 at;
  bool is_path;
  if (step_px.y == 0) {
    at = ivec2(sides.x, path);
    is_path = path < height;
  } else if (step_px.x == 0 || path < width) {
    at = ivec2(path, sides.y);
    is_path = path < width;
  } else {
    int along = path - width + 1;
    at = ivec2(sides.x, step_px.y > 0 ? along : height - 1 - along);
    is_path = along < height;
  }
  if (!is_path) {
    return;
  }
  int words = push.count / 4;
  int first_word = (in_chunk * pixels() + at.y * width + at.x) * words + lane * lane_words;
  int next_word = (step_px.y * width + step_px.x) * words;
  uint before[4 * lane_words];
  for (int k = 0; k < 4 * lane_words; ++k) {
    before[k] = 0;
  }
  uint least = 0;
  uint ahead[lane_words];
  for (int w = 0; w < lane_words; ++w) {
    ahead[w] = texelFetch(costs, first_word + w).x;
  }
  for (int turn = 0; at.x >= 0 && at.x < width && at.y >= 0 && at.y < height; ++turn) {
    ivec2 next = at + step_px;
    bool goes_on = next.x >= 0 && next.x < width && next.y >= 0 && next.y < height;
    edges[turn & 1][gl_LocalInvocationID.x] = before[0] | before[4 * lane_words - 1] << 16;
    subgroupMemoryBarrierShared();
    subgroupBarrier();
    uint below = lane > 0 ? edges[turn & 1][gl_LocalInvocationID.x - 1] >> 16 : kForbidden;
    uint above = lane + 1 < lanes ? edges[turn & 1][gl_LocalInvocationID.x + 1] & 0xffffu : kForbidden;
    uint word[lane_words];
    for (int w = 0; w < lane_words; ++w) {
      word[w] = ahead[w];
      ahead[w] = goes_on ? texelFetch(costs, first_word + next_word + w).x : 0;
    }
    uint jump = least + uint(push.jump_cost);
    uint smallest = kForbidden;
    for (int k = 0; k < 4 * lane_words; ++k) {
      uint own = before[k];
      uint after = k + 1 < 4 * lane_words ? before[k + 1] : above;
      uint best = min(min(own, min(below, after) + uint(push.step_cost)), jump);
      uint value = (word[k / 4] >> (8 * (k % 4)) & 255u) + best - least;
      below = own;
      before[k] = value;
      smallest = min(smallest, value);
    }
    for (int k = 0; k < 2 * lane_words; ++k) {
      atomicAdd(totals[2 * first_word + k], before[2 * k] | before[2 * k + 1] << 16);
    }
    least = subgroupMin(smallest);
    at += step_px;
    first_word += next_word;
  }
}
