// The two scalars of a PCG iteration, from the workgroups' sums [2 * iteration][workgroup]: r . z of iteration
// k at 2 k, p . A p at 2 k + 1.

layout(std430) buffer Sums {
  float sums[];
};

// The sum of one value per workgroup that an earlier kernel left at sums[first ...].
float sum_of_groups(uint first) {
  float value = 0;
  for (uint i = gl_LocalInvocationID.x; i < gl_NumWorkGroups.x; i += kGroupSize) {
    value += sums[first + i];
  }
  return workgroup_sum(vec4(value, 0, 0, 0)).x;
}

float pcg_beta(uint iteration) {
  if (iteration == 0) {
    return 0;
  }
  float before = sum_of_groups((2 * iteration - 2) * gl_NumWorkGroups.x);
  float now = sum_of_groups(2 * iteration * gl_NumWorkGroups.x);
  return before > 0 ? now / before : 0;
}

float pcg_alpha(uint iteration) {
  float rz = sum_of_groups(2 * iteration * gl_NumWorkGroups.x);
  float curvature = sum_of_groups((2 * iteration + 1) * gl_NumWorkGroups.x);
  return curvature > 0 && rz > 0 ? rz / curvature : 0;
}
