// Workgroups that each walk over one contiguous block of the items, and sums over a workgroup and over all of
// them. Few workgroups with long blocks are fast on a CPU; on a GPU there are enough of them to fill it.
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

const uint kGroupSize = 64;
layout(local_size_x = 64) in;

shared vec4 workgroup_parts[kGroupSize];

// First and past-the-end item of this workgroup.
uvec2 block_of(uint item_count) {
  uint stride = kGroupSize * gl_NumWorkGroups.x;
  uint size = (item_count + stride - 1) / stride * kGroupSize;
  uint first = gl_WorkGroupID.x * size;
  return uvec2(first, min(first + size, item_count));
}

// The sum over the workgroup, to every invocation. Uniform control flow only.
vec4 workgroup_sum(vec4 value) {
  barrier();
  vec4 part = subgroupAdd(value);
  if (subgroupElect()) {
    workgroup_parts[gl_SubgroupID] = part;
  }
  barrier();
  vec4 sum = vec4(0);
  for (uint i = 0; i < gl_NumSubgroups; ++i) {
    sum += workgroup_parts[i];
  }
  return sum;
}
