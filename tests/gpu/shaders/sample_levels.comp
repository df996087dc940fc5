#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"

// Reads an image at given places: x and y normalised, z the level.

layout(local_size_x = 64) in;

uniform sampler2D pyramid;
uniform samplerBuffer places;
writeonly buffer Colours { vec4 colours[]; };
layout(push_constant) uniform Push { CountPush push; };

void main() {
  uint index = gl_GlobalInvocationID.x;
  if (index < push.count) {
    vec3 place = texelFetch(places, int(index)).xyz;
    colours[index] = textureLod(pyramid, place.xy, place.z);
  }
}
