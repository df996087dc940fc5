// Solves the symmetric 4 x 4 system J x = y by its Cholesky factor; J with j.damping on its diagonal is positive
// definite.
vec4 solve4(vec4 first, vec4 second, vec2 third, float damping, vec4 y) {
  float l00 = sqrt(max(first.x + damping, 1e-20));
  float l10 = first.y / l00;
  float l20 = first.z / l00;
  float l30 = first.w / l00;
  float l11 = sqrt(max(second.x + damping - l10 * l10, 1e-20));
  float l21 = (second.y - l20 * l10) / l11;
  float l31 = (second.z - l30 * l10) / l11;
  float l22 = sqrt(max(second.w + damping - l20 * l20 - l21 * l21, 1e-20));
  float l32 = (third.x - l30 * l20 - l31 * l21) / l22;
  float l33 = sqrt(max(third.y + damping - l30 * l30 - l31 * l31 - l32 * l32, 1e-20));
  float a = y.x / l00;
  float b = (y.y - l10 * a) / l11;
  float c = (y.z - l20 * a - l21 * b) / l22;
  float d = (y.w - l30 * a - l31 * b - l32 * c) / l33;
  vec4 x;
  x.w = d / l33;
  x.z = (c - l32 * x.w) / l22;
  x.y = (b - l21 * x.z - l31 * x.w) / l11;
  x.x = (a - l10 * x.y - l20 * x.z - l30 * x.w) / l00;
  return x;
}
