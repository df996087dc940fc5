#version 460
#extension GL_GOOGLE_include_directive : require

// One level of a mip chain: every target pixel is the mean of the source over the area that it covers. With an odd
// source size the area spans three rows or columns, the outer two in part.

layout(local_size_x = 8, local_size_y = 8) in;

uniform sampler2D source;
layout(rgba16f) uniform writeonly image2D target;

struct Taps {
  int first;
  int count;
  vec3 weights;
};

// Source pixels and weights that target pixel `index` of `target_size` covers; sizes as in a mip chain.
Taps covered(int index, int source_size, int target_size) {
  if (source_size == target_size) {
    return Taps(index, 1, vec3(1.0, 0.0, 0.0));
  }
  if (source_size == 2 * target_size) {
    return Taps(2 * index, 2, vec3(0.5, 0.5, 0.0));
  }
  float size = float(source_size);
  return Taps(2 * index, 3,
              vec3(float(target_size - index) / size, float(target_size) / size, float(index + 1) / size));
}

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  ivec2 target_size = imageSize(target);
  if (any(greaterThanEqual(pixel, target_size))) {
    return;
  }
  ivec2 source_size = textureSize(source, 0);
  Taps columns = covered(pixel.x, source_size.x, target_size.x);
  Taps rows = covered(pixel.y, source_size.y, target_size.y);
  vec4 sum = vec4(0.0);
  for (int row = 0; row < rows.count; ++row) {
    for (int column = 0; column < columns.count; ++column) {
      sum += rows.weights[row] * columns.weights[column] *
             texelFetch(source, ivec2(columns.first + column, rows.first + row), 0);
    }
  }
  imageStore(target, pixel, sum);
}
