#version 460

// Writes out its specialization constants and its workgroup size.

layout(local_size_x_id = 0) in;
layout(constant_id = 1) const uint block = 4;
layout(constant_id = 2) const int shift = -3;
layout(constant_id = 3) const float weight = 0.5;
layout(constant_id = 4) const bool negate = false;

struct Pair {
  vec4 first;
  vec4 second;
};
uniform Parameters { Pair parameters; };
buffer Values { float values[]; };

void main() {
  if (gl_GlobalInvocationID.x == 0) {
    values[0] = float(block);
    values[1] = float(shift);
    values[2] = negate ? -weight : weight;
    values[3] = float(gl_WorkGroupSize.x);
    values[4] = parameters.first.x + parameters.second.w;
  }
}
