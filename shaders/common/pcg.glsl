// The two scalars of a PCG iteration, from the workgroups' sums [2 * iteration][workgroup]: r . z of iteration
// k at 2 k, p . A p at 2 k + 1.

float pcg_beta(samplerBuffer sums, uint iteration) {
  if (iteration == 0) {
    return 0;
  }
  float before = sum_of_groups(sums, (2 * iteration - 2) * gl_NumWorkGroups.x);
  float now = sum_of_groups(sums, 2 * iteration * gl_NumWorkGroups.x);
  return before > 0 ? now / before : 0;
}

float pcg_alpha(samplerBuffer sums, uint iteration) {
  float rz = sum_of_groups(sums, 2 * iteration * gl_NumWorkGroups.x);
  float curvature = sum_of_groups(sums, (2 * iteration + 1) * gl_NumWorkGroups.x);
  return curvature > 0 && rz > 0 ? rz / curvature : 0;
}
