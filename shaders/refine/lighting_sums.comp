#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"
#include "shading.glsl"

// Normal equations of the lighting [MD19 eq. 3] summed over each workgroup's vertices of M0, displaced as in the
// previous frame. The matrix stands in blocks of the basis parts of sh(); the tenth unknown is the factor of the
// room's irradiance.

layout(push_constant) uniform Push {
  LightingPush push;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer positions;
uniform samplerBuffer normals;
uniform samplerBuffer colours;
uniform samplerBuffer albedo;
uniform samplerBuffer irradiance;
layout(std430) readonly buffer LightBlock {
  Light light;  // of the pass before: says which residuals are outliers
};
layout(std430) writeonly buffer LightingSums {
  vec4 lighting_sums[];  // [workgroup][kLightingSums]
};

#include "displaced_normal.glsl"
#include "lighting.glsl"

// l . SH below which a vertex says nothing of its albedo.
const float kDarkest = 0.05;

void main() {
  mat4 low_low = mat4(0);
  mat4 low_middle = mat4(0);
  mat4 middle_middle = mat4(0);
  vec4 low_last = vec4(0);
  vec4 middle_last = vec4(0);
  vec4 low_right = vec4(0);
  vec4 middle_right = vec4(0);
  vec4 square_sum = vec4(0);  // of the residual over the shading: xx, yy, zz, weights
  vec4 mixed_sum = vec4(0);   // xy, xz, yz
  vec4 room_low = vec4(0);    // of the room's irradiance with the basis
  vec4 room_middle = vec4(0);
  vec4 room_rest = vec4(0);  // with the last of the basis, with itself, its right side
  vec4 rest = vec4(0);  // last x last, last's right side, sum of weights, sum of weighted squared colours
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    vec4 colour = texelFetch(colours, int(i));
    if (colour.w > 0) {
      ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
      vec4 own = texelFetch(positions, int(i));
      vec3 n = displaced_unit_normal(ring, own.xyz + own.w * texelFetch(normals, int(i)).xyz);
      vec3 rho = texelFetch(albedo, int(i)).rgb;
      vec4 room = texelFetch(irradiance, int(i));
      float shading = shade(light, room, n);
      vec3 residual = colour.rgb - shading * rho;
      float weight = colour.w * tukey_weight(light.gain * dot(residual, residual), push.robust_scale);
      Harmonics h = sh(n);
      float square = weight * dot(rho, rho);
      float seen = weight * dot(rho, colour.rgb);
      low_low += outerProduct(h.low, square * h.low);
      low_middle += outerProduct(h.low, square * h.middle);
      middle_middle += outerProduct(h.middle, square * h.middle);
      low_last += square * h.last * h.low;
      middle_last += square * h.last * h.middle;
      low_right += seen * h.low;
      middle_right += seen * h.middle;
      float lamps = room.x + dot(room.yzw, n);
      room_low += square * lamps * h.low;
      room_middle += square * lamps * h.middle;
      room_rest += lamps * vec4(square * h.last, square * lamps, seen, 0);
      vec3 deviation = residual / max(shading, kDarkest);
      square_sum += weight * vec4(deviation * deviation, 1);
      mixed_sum.xyz += weight * deviation.xxy * deviation.yzz;
      rest += vec4(square * h.last * h.last, seen * h.last, weight, weight * dot(colour.rgb, colour.rgb));
    }
  }
  uint first = gl_WorkGroupID.x * kLightingSums;
  for (uint part = 0; part < kLightingSums; ++part) {
    vec4 value = part < 4    ? low_low[part]
                 : part < 8  ? low_middle[part - 4]
                 : part < 12 ? middle_middle[part - 8]
                 : part == 12 ? low_last
                 : part == 13 ? middle_last
                 : part == 14 ? low_right
                 : part == 15 ? middle_right
                 : part == 16 ? rest
                 : part == 17 ? square_sum
                 : part == 18 ? mixed_sum
                 : part == 19 ? room_low
                 : part == 20 ? room_middle
                              : room_rest;
    vec4 sum = workgroup_sum(value);
    if (gl_LocalInvocationID.x == 0) {
      lighting_sums[first + part] = sum;
    }
  }
}
