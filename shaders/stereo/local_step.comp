#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "unknowns.glsl"
#include "count.glsl"
#include "inverse4.glsl"

// A Gauss-Newton step of local spacetime stereo [SF04 eq. 4]: every voxel on its own, d, dx, dy and dt free.

uniform samplerBuffer first_rows;
uniform samplerBuffer second_rows;
uniform samplerBuffer third_rows;
uniform samplerBuffer gradients;
buffer Disparities {
  float disparities[];
};

void main() {
  ivec2 run = run_of(0, unknown_count);
  for (int at = run.x + int(gl_LocalInvocationID.x); at < run.y; at += int(kGroupSize)) {
    vec4 moved = solve4(texelFetch(first_rows, at), texelFetch(second_rows, at), texelFetch(third_rows, at).xy, push.damping,
                        -texelFetch(gradients, at));
    disparities[voxel_of(place_of(texelFetch(unknowns, at)))] += clamp(moved.x, -push.most_move_px, push.most_move_px);
  }
}
