// Weights of the cubic B-spline for the four samples around a position f past the second one, and their derivatives
// with f. Its blur has the same variance (1/3 px^2) at every f: a kernel that is sharp on samples and soft between
// them, as cubic convolution is, makes two pictures of one stripe differ by their fractions alone, and the
// disparities follow (docs/stereo.md).
vec4 bspline(float f) {
  float f2 = f * f;
  float f3 = f2 * f;
  return (1.0 / 6.0) * vec4(1 - 3 * f + 3 * f2 - f3, 4 - 6 * f2 + 3 * f3, 1 + 3 * f + 3 * f2 - 3 * f3, f3);
}
vec4 bspline_slope(float f) {
  float f2 = f * f;
  return 0.5 * vec4(-1 + 2 * f - f2, -4 * f + 3 * f2, 1 + 2 * f - 3 * f2, f2);
}
