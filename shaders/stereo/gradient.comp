#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "volume.glsl"
#include "unknowns.glsl"
#include "count.glsl"
#include "adjoint.glsl"

// Start of the CG solve of [SF04 eq. 9]: r = -[I; Gx; Gy; Gt]^T b, its Jacobi preconditioner, z and the first r . z.

uniform samplerBuffer first_rows;
uniform samplerBuffer second_rows;
uniform samplerBuffer third_rows;
uniform samplerBuffer gradients;
writeonly buffer Inverses {
  float inverses[];  // of the diagonal
};
writeonly buffer SolverStates {
  vec2 solver_states[];  // r, x
};
writeonly buffer Searches {
  vec2 searches[];  // z, search of the iteration before
};
writeonly buffer Sums {
  float sums[];  // [2 * iteration][workgroup] r . z, s . A s
};

float own_coefficient(uint bits) { return adjoint_own(1, bits); }
float square(float value) { return value * value; }

// Of [I; Gx; Gy; Gt]^T J [I; Gx; Gy; Gt], exact: where a window says nothing, those beside it hold its disparity.
float diagonal(int at, ivec4 unknown) {
  Neighbours near = neighbours_of(at, unknown);
  uint word = uint(unknown.y);
  uint x = axis_bits(word, 0);
  uint y = axis_bits(word, 1);
  uint t = axis_bits(word, 2);
  vec3 own = vec3(own_coefficient(x), own_coefficient(y), own_coefficient(t));
  vec4 first = texelFetch(first_rows, at);
  vec4 second = texelFetch(second_rows, at);
  vec2 third = texelFetch(third_rows, at).xy;
  float sum = first.x + dot(own * own, vec3(second.xw, third.y)) +
              2 * (dot(own, first.yzw) + own.x * dot(own.yz, second.yz) + own.y * own.z * third.x);
  sum += square(adjoint_before(x)) * texelFetch(second_rows, near.before.x).x +
         square(adjoint_after(x)) * texelFetch(second_rows, near.after.x).x;
  sum += square(adjoint_before(y)) * texelFetch(second_rows, near.before.y).w +
         square(adjoint_after(y)) * texelFetch(second_rows, near.after.y).w;
  return sum + square(adjoint_before(t)) * texelFetch(third_rows, near.before.z).y +
         square(adjoint_after(t)) * texelFetch(third_rows, near.after.z).y;
}

void main() {
  ivec2 run = run_of(0, unknown_count);
  float rz = 0;
  for (int at = run.x + int(gl_LocalInvocationID.x); at < run.y; at += int(kGroupSize)) {
    ivec4 unknown = texelFetch(unknowns, at);
    float r = -adjoint(gradients, at, unknown);
    float inverse = 1 / (diagonal(at, unknown) + push.damping);
    inverses[at] = inverse;
    solver_states[at] = vec2(r, 0);
    searches[at] = vec2(inverse * r, 0);
    rz += r * inverse * r;
  }
  float total = workgroup_sum(vec4(rz, 0, 0, 0)).x;
  if (gl_LocalInvocationID.x == 0) {
    sums[gl_WorkGroupID.x] = total;
  }
}
