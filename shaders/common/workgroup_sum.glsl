// Sums over a workgroup of any size.
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_KHR_shader_subgroup_arithmetic : require

const uint kMostSubgroups = 64;
shared vec4 workgroup_parts[kMostSubgroups];

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
