// [MD19 eq. 1]: R = (l . SH(n)) rho, where the room's lamps are known R = (l . SH(n) + irradiance(n)) rho, with
// SH(n) = (1, nx, ny, nz, nx ny, nx nz, ny nz, nx^2 - ny^2, 3 nz^2 - 1).

struct Harmonics {
  vec4 low;     // 1, x, y, z
  vec4 middle;  // xy, xz, yz, xx - yy
  float last;   // 3zz - 1
};

Harmonics sh(vec3 n) {
  return Harmonics(vec4(1, n), vec4(n.x * n.y, n.x * n.z, n.y * n.z, n.x * n.x - n.y * n.y), 3 * n.z * n.z - 1);
}

// l . SH(n), multiplied from the left: l (x y) instead of (l x) y would round otherwise.
float shade(Light l, vec3 n) {
  return l.low.x + dot(l.low.yzw, n) + l.middle.x * n.x * n.y + l.middle.y * n.x * n.z + l.middle.z * n.y * n.z +
         l.middle.w * (n.x * n.x - n.y * n.y) + l.last * (3 * n.z * n.z - 1);
}

// d (l . SH(n)) / d n with n taken as three free numbers.
vec3 shade_gradient(Light l, vec3 n) {
  return l.low.yzw + vec3(l.middle.x * n.y + l.middle.y * n.z + 2 * l.middle.w * n.x,
                          l.middle.x * n.x + l.middle.z * n.z - 2 * l.middle.w * n.y,
                          l.middle.y * n.x + l.middle.z * n.y + 6 * l.last * n.z);
}

// At a vertex: with what the room's lamps give it there, irradiance.x + irradiance.yzw . n (refine::RoomLight).
float shade(Light l, vec4 irradiance, vec3 n) {
  return shade(l, n) + l.room.x * (irradiance.x + dot(irradiance.yzw, n));
}

vec3 shade_gradient(Light l, vec4 irradiance, vec3 n) {
  return shade_gradient(l, n) + l.room.x * irradiance.yzw;
}

// The metric of colour residuals (see lighting_solve) times a colour.
vec3 metric_times(Light l, vec3 colour) {
  return l.metric_diagonal.xyz * colour +
         vec3(dot(l.metric_mixed.xy, colour.yz), dot(l.metric_mixed.xz, colour.xz), dot(l.metric_mixed.yz, colour.xy));
}

// Tukey's weight of a squared residual; scale 0: plain squares. What is not a number stays so, to be noticed.
float tukey_weight(float square, float scale) {
  if (scale <= 0) {
    return 1;
  }
  float t = 1 - square / (scale * scale);
  return t < 0 ? 0 : t * t;
}

float tukey_loss(float square, float scale) {
  if (scale <= 0) {
    return square;
  }
  float t = 1 - square / (scale * scale);
  t = t < 0 ? 0 : t;
  return scale * scale / 3 * (1 - t * t * t);
}

// Weight and loss of a squared bend: quadratic when small, linear beyond `slope`, so that folds stay sharp
// (Charbonnier). slope 0: plain squares.
float fold_weight(float square, float slope) {
  return slope > 0 ? inversesqrt(1 + square / (slope * slope)) : 1;
}

float fold_loss(float square, float slope) {
  return slope > 0 ? 2 * slope * slope * (sqrt(1 + square / (slope * slope)) - 1) : square;
}
