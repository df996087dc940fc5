#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "common/pcg.glsl"
#include "volume.glsl"
#include "unknowns.glsl"
#include "count.glsl"

// First half of a CG iteration of [SF04 eq. 9]: s = z + beta s, q = J [I; Gx; Gy; Gt] s at every window, where
// [Gx; Gy; Gt] s are differences [SF04 eq. 8], and s . A s as the sum of [I; G] s . q over the windows.

uniform samplerBuffer first_rows;
uniform samplerBuffer second_rows;
uniform samplerBuffer third_rows;
uniform samplerBuffer searches;
writeonly buffer Products {
  vec4 products[];
};

float search_at(int at, float beta) {
  vec2 search = texelFetch(searches, at).xy;
  return search.x + beta * search.y;
}

void main() {
  float beta = pcg_beta(push.iteration);
  ivec2 run = run_of(0, unknown_count);
  float curvature = 0;
  for (int at = run.x + int(gl_LocalInvocationID.x); at < run.y; at += int(kGroupSize)) {
    ivec4 unknown = texelFetch(unknowns, at);
    uint word = uint(unknown.y);
    Neighbours near = neighbours_of(at, unknown);
    float own = search_at(at, beta);
    vec3 after = vec3(search_at(near.after.x, beta), search_at(near.after.y, beta), search_at(near.after.z, beta));
    vec3 before = vec3(search_at(near.before.x, beta), search_at(near.before.y, beta), search_at(near.before.z, beta));
    vec3 quotients = vec3(quotient(axis_bits(word, 0)), quotient(axis_bits(word, 1)), quotient(axis_bits(word, 2)));
    vec4 s = vec4(own, (after - before) * quotients);
    vec4 first = texelFetch(first_rows, at);
    vec4 second = texelFetch(second_rows, at);
    vec2 third = texelFetch(third_rows, at).xy;
    vec4 q = vec4(dot(first, s), dot(vec4(first.y, second.xyz), s), dot(vec4(first.z, second.yw, third.x), s),
                  dot(vec4(first.w, second.z, third), s));
    curvature += dot(s, q) + push.damping * own * own;
    products[at] = q;
  }
  float total = workgroup_sum(vec4(curvature, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[(2 * push.iteration + 1) * gl_NumWorkGroups.x + gl_WorkGroupID.x] = total;
  }
}
