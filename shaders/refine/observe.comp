#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/workgroup.glsl"
#include "topology.glsl"

// Coarse normals ([MD19 eq. 5] at d = 0), vertex spacing, and what one camera sees at every vertex: I of [MD19 eq. 2],
// the image sampled where M_d projects to, from the mip level whose pixels are half as wide as the vertices lie
// apart (wider ones wash the shading out), and how far that colour can be trusted.

layout(push_constant) uniform Push {
  ObservePush push;
};
layout(std140) uniform Frame {
  FrameParameters frame;
};
uniform isamplerBuffer vertex_rings;
uniform isamplerBuffer ring_indices;
uniform samplerBuffer positions;  // [vertex_count] position, displacement
uniform sampler2D linear_image;
layout(std430) readonly buffer Depth {
  uint depth_bits[];
};
layout(std430) writeonly buffer Normals {
  vec4 normals[];  // [vertex_count] unit coarse normal, spacing_mm
};
layout(std430) writeonly buffer Colours {
  vec4 colours[];  // [vertex_count] linear RGB, weight 0 to 1
};

// A vertex counts as hidden when the surface before it is nearer by more than this: finer levels and the
// coarse mesh that the depth map shows differ by less.
const float kDepthMarginMm = 5;
// Cosine to the viewing ray at which a vertex begins to count, and from which on it counts in full.
const float kGrazing = 0.15;
const float kFacing = 0.45;

// A step in depth this much larger than a vertex spacing is an outline.
const float kOutlineMarginMm = 15;

float depth_at(vec2 map) {
  ivec2 at = clamp(ivec2(round(map)), ivec2(0), ivec2(push.depth_size_px - 1));
  return uintBitsToFloat(depth_bits[at.y * push.depth_size_px + at.x]);
}

void main() {
  uvec2 block = block_of(push.vertex_count);
  for (uint i = block.x + gl_LocalInvocationID.x; i < block.y; i += kGroupSize) {
    ivec2 ring = texelFetch(vertex_rings, int(i)).xy;
    vec4 own = texelFetch(positions, int(i));
    int size = ring_size(ring);
    int first = 4 * ring.x;
    vec3 to_first = texelFetch(positions, texelFetch(ring_indices, first).x).xyz - own.xyz;
    vec3 to_next = to_first;
    vec3 normal = vec3(0);
    float spacing = length(to_first);
    for (int k = 1; k < size; ++k) {
      vec3 to_this = to_next;
      to_next = texelFetch(positions, texelFetch(ring_indices, first + k).x).xyz - own.xyz;
      normal += cross(to_this, to_next);
      spacing += length(to_next);
    }
    if (is_closed(ring)) {
      normal += cross(to_next, to_first);
    }
    normal *= inversesqrt(max(dot(normal, normal), 1e-30));
    spacing /= float(size);

    vec3 p = (frame.view_from_reference * vec4(own.xyz + own.w * normal, 1)).xyz;
    float z = -p.z;
    vec4 colour = vec4(0);
    if (is_free(ring) && z > 1 && frame.source_px.z != 0) {
      vec2 px = frame.projection.xy * vec2(p.x, -p.y) / z + frame.projection.zw;
      vec2 texture_position = (px + 0.5) * frame.image_size.zw;
      float spacing_px = spacing * frame.projection.x / z;
      vec4 seen = textureLod(linear_image, texture_position, log2(max(0.5 * spacing_px, 1.0)));
      float inside =
          all(greaterThan(px, vec2(0))) && all(lessThan(px, frame.image_size.xy - 1)) ? 1.0 : 0.0;
      vec3 normal_in_view = (frame.view_from_reference * vec4(normal, 0)).xyz;
      float facing = smoothstep(kGrazing, kFacing, dot(normal_in_view, -normalize(p)));
      vec2 map = px * frame.depth_from_px.xy + frame.depth_from_px.zw;
      float reach = max(1, spacing_px) * frame.depth_from_px.x;
      float shown = z > depth_at(map) + kDepthMarginMm ? 0.0 : 1.0;
      // The image is read over about a spacing: at an outline that mixes in what lies behind.
      float behind = max(max(depth_at(map + vec2(reach, 0)), depth_at(map - vec2(reach, 0))),
                         max(depth_at(map + vec2(0, reach)), depth_at(map - vec2(0, reach))));
      shown *= behind > z + spacing + kOutlineMarginMm ? 0.0 : 1.0;
      float trusted = smoothstep(0.6, 1.0, seen.a);
      colour = vec4(seen.rgb, inside * facing * shown * trusted);
    }
    normals[i] = vec4(normal, spacing);
    colours[i] = colour;
  }
}
