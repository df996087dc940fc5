#version 460
#extension GL_GOOGLE_include_directive : require
#include "layout.h"
#include "common/finite.glsl"
#include "common/workgroup_sum.glsl"
#include "topology.glsl"

// A Gauss-Newton step [MD19 eq. 8] patch by patch: each workgroup solves the vertices of one patch and of a halo
// around it by PCG [MD19 sec. 4.4], with all others where they are, and moves the patch's own (a restricted additive
// Schwarz step). All iterations are one dispatch: a patch waits for nobody.
//
// p . A p = |J p|^2 + the other terms' squares, so that J^T J p need not be known for the step's length. Products
// follow p: J p = J z + beta (J p of the iteration before), so the rings are read for one number a vertex, z.
//
// What an iteration leaves for other lanes of the workgroup lies in shared memory on a GPU. On a CPU it lies in
// storage texels, of every patch its own: there shared memory is read one lane after the other, texels all at once.

layout(local_size_x_id = 0) in;
layout(constant_id = 1) const bool kInSharedMemory = false;
layout(constant_id = 2) const uint kSharedPlaces = 1;  // of the largest patch, where they lie in shared memory
layout(push_constant) uniform Push {
  SolvePush push;
};
uniform isamplerBuffer patches;         // first record; records that are the patch's own, solved, in all
uniform isamplerBuffer patch_vertices;  // of a record: vertex, first group of its ring, of the record's, ring size
uniform isamplerBuffer patch_groups;    // the ring by places in the patch, four a group; place 0 holds 0
uniform samplerBuffer solver_starts;    // [vertex_count] r, inverse diagonal, diagonal of the terms in d_i alone,
                                        // w3 / (spacing ring size)^2
uniform samplerBuffer jacobian_rows;     // [group_count] four entries
uniform samplerBuffer jacobian_columns;  // [group_count] four entries
layout(r32f) uniform coherent imageBuffer preconditioned;  // [place] z
layout(rg32f) uniform coherent imageBuffer products;       // [place] (J p)_i, w3 (L p)_i / (spacing^2 ring size)
layout(rgba32f) uniform imageBuffer states;                // [place] r, x, p: read and written by one lane alone
layout(std430) buffer Positions {
  vec4 positions[];  // [vertex_count] position, displacement
};

shared float shared_z[kSharedPlaces];
shared vec2 shared_products[kSharedPlaces];

// Of the patch's places the first among the storage texels.
int first_place;

float z_at(int place) {
  return kInSharedMemory ? shared_z[place] : imageLoad(preconditioned, first_place + place).x;
}
void set_z(int place, float value) {
  if (kInSharedMemory) {
    shared_z[place] = value;
  } else {
    imageStore(preconditioned, first_place + place, vec4(value, 0, 0, 0));
  }
}
vec2 product_at(int place) {
  return kInSharedMemory ? shared_products[place] : imageLoad(products, first_place + place).xy;
}
void set_product(int place, vec2 value) {
  if (kInSharedMemory) {
    shared_products[place] = value;
  } else {
    imageStore(products, first_place + place, vec4(value, 0, 0));
  }
}

// What an invocation wrote is there for the workgroup's others, and r . z or p . A p known to them all.
float sum_and_publish(float value) {
  if (!kInSharedMemory) {
    groupMemoryBarrier();
  }
  float sum = workgroup_sum(vec4(value, 0, 0, 0)).x;
  if (!kInSharedMemory) {
    groupMemoryBarrier();
  }
  return sum;
}

void main() {
  int patch_index = int(push.first_patch + gl_WorkGroupID.x);
  ivec4 patch_at = texelFetch(patches, patch_index);
  int lane = int(gl_LocalInvocationID.x);
  int lanes = int(gl_WorkGroupSize.x);
  int first = patch_at.x;
  int own = patch_at.y;
  int solved = patch_at.z;
  int all = patch_at.w;
  // Of the places before it each patch of the set has one more than records.
  first_place = first - push.first_record + int(gl_WorkGroupID.x);

  float part = 0;
  for (int k = lane; k < all; k += lanes) {
    float z = 0;
    if (k < solved) {
      vec4 start = texelFetch(solver_starts, texelFetch(patch_vertices, first + k).x);
      z = start.y * start.x;
      part += start.x * z;
      imageStore(states, first_place + k, vec4(start.x, 0, 0, 0));
    }
    set_z(k + 1, z);
    set_product(k + 1, vec2(0));
  }
  if (lane == 0) {
    set_z(0, 0);
    set_product(0, vec2(0));
  }
  float rz = sum_and_publish(part);
  float beta = 0;

  for (uint iteration = 0; iteration < push.pcg_iterations; ++iteration) {
    part = 0;
    for (int k = lane; k < all; k += lanes) {
      ivec4 at = texelFetch(patch_vertices, first + k);
      vec4 start = texelFetch(solver_starts, at.x);
      float data = 0;
      float sum = 0;
      int groups = (at.w + 3) / 4;
      for (int group = 0; group < groups; ++group) {
        ivec4 j = texelFetch(patch_groups, at.z + group);
        vec4 z = vec4(z_at(j.x), z_at(j.y), z_at(j.z), z_at(j.w));
        data += dot(texelFetch(jacobian_rows, at.y + group), z);
        sum += (z.x + z.y) + (z.z + z.w);
      }
      float own_z = z_at(k + 1);
      vec2 product = vec2(data, start.w * (own_z * float(at.w) - sum)) + beta * product_at(k + 1);
      set_product(k + 1, product);
      part += product.x * product.x + (start.w > 0 ? product.y * product.y / start.w : 0);
      if (k < solved) {
        float p = own_z + beta * imageLoad(states, first_place + k).z;
        part += start.z * p * p;
      }
    }
    float curvature = sum_and_publish(part);
    float alpha = curvature > 0 && rz > 0 ? rz / curvature : 0;

    part = 0;
    for (int k = lane; k < solved; k += lanes) {
      ivec4 at = texelFetch(patch_vertices, first + k);
      vec4 start = texelFetch(solver_starts, at.x);
      float data = 0;
      float bends = 0;
      int groups = (at.w + 3) / 4;
      for (int group = 0; group < groups; ++group) {
        ivec4 j = texelFetch(patch_groups, at.z + group);
        vec2 a = product_at(j.x);
        vec2 b = product_at(j.y);
        vec2 c = product_at(j.z);
        vec2 d = product_at(j.w);
        data += dot(texelFetch(jacobian_columns, at.y + group), vec4(a.x, b.x, c.x, d.x));
        bends += (a.y + b.y) + (c.y + d.y);
      }
      vec4 state = imageLoad(states, first_place + k);
      float p = z_at(k + 1) + beta * state.z;
      float own_bend = product_at(k + 1).y * float(at.w);
      state.x -= alpha * (data + own_bend - bends + start.z * p);
      state.y += alpha * p;
      state.z = p;
      float z = start.y * state.x;
      part += state.x * z;
      imageStore(states, first_place + k, state);
      set_z(k + 1, z);
    }
    float rz_before = rz;
    rz = sum_and_publish(part);
    beta = rz_before > 0 ? rz / rz_before : 0;
  }

  for (int k = lane; k < own; k += lanes) {
    int vertex = texelFetch(patch_vertices, first + k).x;
    float moved = positions[vertex].w + imageLoad(states, first_place + k).y;
    // What is no number must be seen when it is read back.
    positions[vertex].w = is_finite(moved) ? clamp(moved, -push.bound_mm, push.bound_mm) : moved;
  }
}
