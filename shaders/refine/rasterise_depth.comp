#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"

// Draws the coarse mesh as one camera sees it into a square depth map of the face's region: the nearest z of every pixel, mm.

layout(push_constant) uniform Push {
  DepthPush push;
};
layout(std140) uniform Frame {
  FrameParameters frame;
};
uniform samplerBuffer positions;   // [vertex_count] shading frame, mm
uniform isamplerBuffer triangles;  // [triangle_count] three vertices and 0
layout(std430) buffer Depth {
  uint depth_bits[];  // [size_px][size_px] z as float bits, which order like the positive numbers they are
};

const float kNearMm = 10;

vec3 map_position(int vertex) {
  vec3 p = (frame.view_from_reference * vec4(texelFetch(positions, vertex).xyz, 1)).xyz;
  float z = -p.z;
  vec2 px = frame.projection.xy * vec2(p.x, -p.y) / z + frame.projection.zw;
  return vec3(px * frame.depth_from_px.xy + frame.depth_from_px.zw, z);
}

void main() {
  uvec2 block = block_of(push.triangle_count);
  for (uint t = block.x + gl_LocalInvocationID.x; t < block.y; t += kGroupSize) {
    ivec3 corners = texelFetch(triangles, int(t)).xyz;
    vec3 a = map_position(corners.x);
    vec3 b = map_position(corners.y);
    vec3 c = map_position(corners.z);
    float area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if (min(min(a.z, b.z), c.z) < kNearMm || abs(area) < 1e-9) {
      continue;
    }
    ivec2 low = ivec2(max(ceil(min(min(a.xy, b.xy), c.xy)), vec2(0)));
    ivec2 high = ivec2(min(floor(max(max(a.xy, b.xy), c.xy)), vec2(push.size_px - 1)));
    for (int y = low.y; y <= high.y; ++y) {
      for (int x = low.x; x <= high.x; ++x) {
        vec2 p = vec2(x, y);
        float wb = ((p.x - a.x) * (c.y - a.y) - (p.y - a.y) * (c.x - a.x)) / area;
        float wc = ((b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x)) / area;
        float wa = 1 - wb - wc;
        if (min(min(wa, wb), wc) >= -1e-4) {
          atomicMin(depth_bits[y * push.size_px + x], floatBitsToUint(wa * a.z + wb * b.z + wc * c.z));
        }
      }
    }
  }
}
