#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "layout.h"
#include "lighting.glsl"

// Solves [MD19 eq. 3] by Cholesky, the factor of the room's irradiance with it. One workgroup. The temporal
// weight counts in units of what the vertices weigh
// together, so it holds for any mesh and image size. Without a previous frame, the prior is the constant light
// that fits best, or where the room's lamps are known these alone, with little weight: it keeps directions dark that
// no vertex faces.

layout(push_constant) uniform Push {
  LightingPush push;
};
layout(std140) uniform Frame {
  FrameParameters frame;
};
layout(std430) readonly buffer LightingSums {
  vec4 lighting_sums[];
};
layout(std430) readonly buffer PreviousBlock {
  Light previous;
};
layout(std430) writeonly buffer LightBlock {
  Light light;
};

// From here on the covariance's part is lost in the floor: plain squares.
const float kPlainMetric = 1e3;
const float kFirstPrior = 1e-3;
// Relative to the matrix's largest entry: below it a direction of light is not determined at all.
const float kLeastPrior = 1e-6;

// Each sum is added up in so many slices side by side, and these one after the other: always in the same order.
const uint kSlices = 5;
layout(local_size_x = 128) in;
shared vec4 slices[kSlices * kLightingSums];
shared vec4 total[kLightingSums];

void add_up() {
  uint part = gl_LocalInvocationID.x % kLightingSums;
  uint slice = gl_LocalInvocationID.x / kLightingSums;
  if (slice < kSlices) {
    vec4 sum = vec4(0);
    for (uint group = slice; group < push.group_count; group += kSlices) {
      sum += lighting_sums[group * kLightingSums + part];
    }
    slices[gl_LocalInvocationID.x] = sum;
  }
  barrier();
  if (slice == 0) {
    vec4 sum = slices[part];
    for (uint k = 1; k < kSlices; ++k) {
      sum += slices[k * kLightingSums + part];
    }
    total[part] = sum;
  }
  barrier();
}

// Where skin differs from its albedo as known, it does so in certain directions of colour (blood, melanin,
// hair, noise); shading moves all channels alike. Weighting residuals by the inverse of their covariance
// over the face, as in generalised least squares, lets the displacements follow what looks like shading.
void set_metric() {
  vec3 square = total[17].xyz / max(total[17].w, 1e-6);
  vec3 mixed = total[18].xyz / max(total[17].w, 1e-6);
  float mean_square = (square.x + square.y + square.z) / 3;
  vec3 diagonal = square + push.metric_floor * mean_square + 1e-8;
  vec3 minor = diagonal.yxx * diagonal.zzy - mixed.zyx * mixed.zyx;
  vec3 other = vec3(mixed.y * mixed.z - mixed.x * diagonal.z, mixed.x * mixed.z - mixed.y * diagonal.y,
                    mixed.x * mixed.y - mixed.z * diagonal.x);
  // Scaled so that grey residuals keep their size.
  float grey = minor.x + minor.y + minor.z + 2 * (other.x + other.y + other.z);
  float unit = 3 / max(grey, 1e-30);
  bool known = total[17].w > 0 && push.metric_floor < kPlainMetric;
  light.metric_diagonal = known ? vec4(unit * minor, 0) : vec4(1, 1, 1, 0);
  light.metric_mixed = known ? vec4(unit * other, 0) : vec4(0);
}

void main() {
  add_up();
  if (gl_LocalInvocationID.x != 0) {
    return;
  }
  float scale = total[0].x;
  if (!(scale > 0)) {
    light = previous;
    return;
  }
  // Unrolled, so that the matrix lies in registers: arrays under a running index go to memory.
  float a[10][10];
  float b[10];
  [[unroll]] for (int row = 0; row < 4; ++row) {
    [[unroll]] for (int column = 0; column < 4; ++column) {
      a[row][column] = total[column][row];
      a[row][column + 4] = total[column + 4][row];
      a[row + 4][column] = total[row + 4][column];
      a[row + 4][column + 4] = total[column + 8][row];
    }
    a[row][8] = total[12][row];
    a[8][row] = total[12][row];
    a[row + 4][8] = total[13][row];
    a[8][row + 4] = total[13][row];
    b[row] = total[14][row];
    b[row + 4] = total[15][row];
    a[9][row] = total[19][row];
    a[9][row + 4] = total[20][row];
  }
  a[8][8] = total[16].x;
  b[8] = total[16].y;
  a[9][8] = total[21].x;
  a[9][9] = total[21].y;
  b[9] = total[21].z;

  bool keep = frame.keep_lighting > 0 && previous.valid > 0;
  float weight = (keep ? max(push.temporal_weight, kLeastPrior) : kFirstPrior) * scale;
  float prior[10];
  [[unroll]] for (int row = 0; row < 4; ++row) {
    prior[row] = keep ? previous.low[row] : 0;
    prior[row + 4] = keep ? previous.middle[row] : 0;
  }
  prior[8] = keep ? previous.last : 0;
  prior[9] = keep ? previous.room.x : 1;
  if (!keep && !(a[9][9] > 0)) {
    prior[0] = b[0] / scale;
  }
  // In the unit of what the frame says of it, which is not l's.
  float room_weight = max(weight / scale * a[9][9], kLeastPrior * scale);
  [[unroll]] for (int row = 0; row < 10; ++row) {
    float held = row < 9 ? weight : room_weight;
    a[row][row] += held;
    b[row] += held * prior[row];
  }

  [[unroll]] for (int column = 0; column < 10; ++column) {
    [[unroll]] for (int k = 0; k < column; ++k) {
      [[unroll]] for (int row = column; row < 10; ++row) {
        a[row][column] -= a[row][k] * a[column][k];
      }
    }
    float inverse = inversesqrt(max(a[column][column], 1e-12 * scale));
    [[unroll]] for (int row = column; row < 10; ++row) {
      a[row][column] *= inverse;
    }
  }
  [[unroll]] for (int row = 0; row < 10; ++row) {
    [[unroll]] for (int k = 0; k < row; ++k) {
      b[row] -= a[row][k] * b[k];
    }
    b[row] /= a[row][row];
  }
  [[unroll]] for (int row = 9; row >= 0; --row) {
    [[unroll]] for (int k = row + 1; k < 10; ++k) {
      b[row] -= a[k][row] * b[k];
    }
    b[row] /= a[row][row];
  }
  light.low = vec4(b[0], b[1], b[2], b[3]);
  light.middle = vec4(b[4], b[5], b[6], b[7]);
  light.last = b[8];
  light.room = vec4(b[9], 0, 0, 0);
  light.weight = total[16].z;
  light.gain = 3 * total[16].z / max(total[16].w, 1e-6 * total[16].z);
  light.valid = 1;
  set_metric();
}
