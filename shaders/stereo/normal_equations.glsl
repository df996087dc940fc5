// The normal equations of one window after its best gain and bias were taken out (docs/stereo.md, S4 to S8),
// with disparities that are linear within it [SF04 eq. 3]:
// E(p + q) = E(p) + 2 b . q + q . J q for the parameters (d, dx, dy, dt). Included with sums_xy and disparities
// declared.

struct Window {
  vec4 j_first;    // J00, J01, J02, J03
  vec4 j_second;   // J11, J12, J13, J22
  vec2 j_third;    // J23, J33
  vec4 b;
  float energy;    // E(p), weighted
  float variance;  // of a grey value after the match
  float correlation;
  float bias_square;  // of d, px^2, of what the field bends within the window
};

float slope_of(int voxel, int stride, uint bits) {
  float before = texelFetch(disparities, (bits & kLinkBefore) != 0 ? voxel - stride : voxel).x;
  float after = texelFetch(disparities, (bits & kLinkAfter) != 0 ? voxel + stride : voxel).x;
  return (after - before) * quotient(bits);
}

Window no_window() {
  return Window(vec4(0), vec4(0), vec2(0), vec4(0), 0, 0, 0, 0);
}

// place: of the window's middle in the volume; word: its links.
Window window_of(ivec3 place, uint word) {
  ivec3 extent = box_extent();
  int slice = extent.x * extent.y;
  int plane = slice * extent.z;
  ivec3 in_box = place - box_origin();
  int at_window = 7 * band.places.w + (in_box.z * extent.y + in_box.y) * extent.x + in_box.x;
  int slot = place.z;
  int voxel = voxel_of(place);
  vec4 a = vec4(0);         // 1, l, w, ll
  vec4 c = vec4(0);         // lw, ww, hd, hdw
  vec4 h = vec4(0);         // h (1, u, v, s)
  vec4 hw = vec4(0);
  vec4 hl = vec4(0);
  vec4 hhd = vec4(0);
  float hhdd = 0;
  vec4 m_first = vec4(0);   // hh (1, u, v, s)
  vec4 m_second = vec4(0);  // hh (uu, uv, us, vv)
  vec2 m_third = vec2(0);   // hh (vs, ss)
  for (int k = 0; k <= 2 * radius_t; ++k) {
    // A slot that the volume does not have counts as 0 times one that it has.
    int there = clamp(k, radius_t - slot, radius_t + push.volume.z - 1 - slot);
    float has = there == k ? 1 : 0;
    int from = at_window + (there - radius_t) * slice;
    float s = float(k - radius_t);
    a += has * texelFetch(sums_xy, from);
    c += has * texelFetch(sums_xy, from + plane);
    vec4 f2 = has * texelFetch(sums_xy, from + 2 * plane);
    vec4 f3 = has * texelFetch(sums_xy, from + 3 * plane);
    vec4 f4 = has * texelFetch(sums_xy, from + 4 * plane);
    vec4 f5 = has * texelFetch(sums_xy, from + 5 * plane);
    vec4 f6 = has * texelFetch(sums_xy, from + 6 * plane);
    h += vec4(f2.xyz, f2.x * s);
    hhdd += f2.w;
    hw += vec4(f3.xyz, f3.x * s);
    hl += vec4(f3.w, f4.xy, f3.w * s);
    hhd += vec4(f4.zw, f5.x, f4.z * s);
    m_first += vec4(f5.yzw, f5.y * s);
    m_second += vec4(f6.xy, f5.z * s, f6.z);
    m_third += vec2(f5.w, f5.y * s) * s;
  }
  // At least half the samples of one slot's window.
  if (2 * a.x < float((2 * radius_x + 1) * (2 * radius_y + 1))) {
    return no_window();
  }
  float inverse_count = 1 / a.x;
  float mean_l = a.y * inverse_count;
  float mean_w = a.z * inverse_count;
  float ll = a.w - a.y * mean_l;
  float lw = c.x - a.y * mean_w;
  float ww = c.y - a.z * mean_w;
  float least = push.least_texture * push.least_texture * a.x;
  if (ll < least || ww < least || lw <= 0) {
    return no_window();
  }
  float inverse_ww = 1 / ww;
  float gain = lw * inverse_ww;
  float residual = max(ll - lw * gain, 0);

  Window window;
  window.correlation = lw * inversesqrt(ll * ww);
  window.variance = residual * inverse_count;
  float weight = 1 / (window.variance + push.noise * push.noise);
  window.energy = weight * residual;  // a window of G, the energy of [SF04 eq. 5], weighed by the noise

  vec4 p = vec4(texelFetch(disparities, voxel).x, slope_of(voxel, 1, axis_bits(word, 0)),
                slope_of(voxel, push.volume.x, axis_bits(word, 1)),
                slope_of(voxel, push.volume.x * push.volume.y, axis_bits(word, 2)));

  // How far the field strays from the window's plane, before J is projected; bend is kappa (docs/stereo.md, S8).
  vec4 mp = vec4(dot(m_first, p), dot(vec4(m_first.y, m_second.xyz), p),
                 dot(vec4(m_first.z, m_second.yw, m_third.x), p), dot(vec4(m_first.w, m_second.z, m_third), p));
  float stray = max(dot(p, mp) - 2 * dot(p, hhd) + hhdd, 0) / max(m_first.x, 1e-12);
  float bend = 1 / (1 + stray / (push.straddle_px * push.straddle_px));
  // A parabola u^2 about the plane that fits it best: off by the mean of u^2 in the middle, and by the root of the mean
  // of u^4, 9/5 of the square, over the window. The pull to the plane is taken back by `bend`.
  window.bias_square = bend * bend * stray * (5.0 / 9.0);

  vec4 hwc = hw - mean_w * h;
  vec4 hlc = hl - mean_l * h;
  float hdwc = c.w - mean_w * c.z;
  float scale = weight * gain * gain;
  vec4 ha = h * inverse_count;
  vec4 hb = hwc * inverse_ww;
  window.j_first = scale * (m_first - h.x * ha - hwc.x * hb);
  window.j_second = scale * (m_second - vec4(h.y * ha.yzw, h.z * ha.z) - vec4(hwc.y * hb.yzw, hwc.z * hb.z));
  window.j_third = scale * (m_third - vec2(h.z * ha.w, h.w * ha.w) - vec2(hwc.z * hb.w, hwc.w * hb.w));
  vec4 jp = vec4(dot(window.j_first, p), dot(vec4(window.j_first.y, window.j_second.xyz), p),
                 dot(vec4(window.j_first.z, window.j_second.yw, window.j_third.x), p),
                 dot(vec4(window.j_first.w, window.j_second.z, window.j_third), p));
  vec4 stray_part = jp - scale * (hhd - ha * c.z - hb * hdwc);
  window.b = bend * stray_part - weight * gain * (hlc - gain * hwc);
  return window;
}
