#include "stereo_vector.hpp"

#include <algorithm>
#include <array>
#include <barrier>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <ctime>
#include <thread>

namespace facet::bench {
namespace {

using Floats = std::vector<float>;
constexpr int kTileX = 64;
constexpr int kTileY = 8;
constexpr std::size_t kSamples = 5;  // counted, l, w, h, d
constexpr std::size_t kSumsX = 20;
constexpr std::size_t kSumsXY = 27;

double seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

class Solver {
 public:
  Solver(const stereo::VolumeSize& size, std::span<const float> left, std::span<const float> right,
         std::span<const float> start, const stereo::SpacetimeOptions& options, int threads)
      : size_(size),
        options_(options),
        left_(left),
        right_(right),
        threads_(threads),
        pad_(size.slot_voxels() + 1),
        rx_(options.window_x / 2),
        ry_(options.window_y / 2),
        rt_(options.window_t / 2) {
    const std::size_t padded = size.voxels() + 2 * pad_;
    for (Floats* plane : {&field_, &residual_, &inverse_, &search_, &update_}) {
      plane->assign(padded, 0.0F);
    }
    for (auto* planes : {&after_, &before_}) {
      planes->fill(Floats(padded, 0.0F));
    }
    hessian_.fill(Floats(padded, 0.0F));
    gradient_.fill(Floats(padded, 0.0F));
    solved_.assign(padded, 0.0F);
    for (std::size_t i = 0; i < size.voxels(); ++i) {
      field_[pad_ + i] = std::isnan(start[i]) ? 0 : start[i];
      solved_[pad_ + i] = std::isnan(start[i]) ? 0.0F : 1.0F;
      const std::array<std::size_t, 3> stride{1, static_cast<std::size_t>(size.width_px), size.slot_voxels()};
      const std::array<int, 3> extent{size.width_px, size.height_px, size.slots};
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const auto place = static_cast<int>(i / stride[axis]) % extent[axis];
        const auto linked = [&](bool there, std::size_t other) {
          return there && std::abs(start[i] - start[other]) <= options.break_px;
        };
        const bool before = linked(place > 0, i - stride[axis]);
        const bool after = linked(place + 1 < extent[axis], i + stride[axis]);
        const float quotient = before && after ? 0.5F : 1.0F;
        before_[axis][pad_ + i] = before ? quotient : 0;
        after_[axis][pad_ + i] = after ? quotient : 0;
      }
    }
    stride_ = {1, static_cast<std::ptrdiff_t>(size.width_px),
               static_cast<std::ptrdiff_t>(size.slot_voxels())};
  }

  VectorStereoResult run() {
    std::barrier barrier(threads_);
    partial_.assign(static_cast<std::size_t>(threads_) * 16, 0.0);
    VectorStereoResult out;
    const std::clock_t begin = std::clock();
    std::vector<std::thread> crew;
    crew.reserve(static_cast<std::size_t>(threads_));
    for (int thread = 0; thread < threads_; ++thread) {
      crew.emplace_back([&, thread] { work(thread, barrier, out); });
    }
    for (std::thread& member : crew) {
      member.join();
    }
    out.cpu_ms = 1e3 * static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC / options_.steps;
    out.windows_ms *= 1e3 / options_.steps;
    out.solve_ms *= 1e3 / options_.steps;
    out.disparity_px.assign(field_.begin() + static_cast<std::ptrdiff_t>(pad_),
                            field_.begin() + static_cast<std::ptrdiff_t>(pad_ + size_.voxels()));
    return out;
  }

 private:
  template <typename Barrier>
  double total(int thread, double value, Barrier& barrier) {
    partial_[static_cast<std::size_t>(thread) * 16] = value;
    barrier.arrive_and_wait();
    double sum = 0;
    for (int k = 0; k < threads_; ++k) {
      sum += partial_[static_cast<std::size_t>(k) * 16];
    }
    barrier.arrive_and_wait();
    return sum;
  }

  template <typename Barrier>
  void work(int thread, Barrier& barrier, VectorStereoResult& out) {
    const auto parts = static_cast<std::size_t>(threads_);
    const std::size_t first = pad_ + size_.voxels() * static_cast<std::size_t>(thread) / parts;
    const std::size_t last = pad_ + size_.voxels() * (static_cast<std::size_t>(thread) + 1) / parts;
    Scratch scratch(size_.slots, rx_, ry_);
    for (int step = 0; step < options_.steps; ++step) {
      const double begin = seconds();
      int tile = 0;
      for (int y = 0; y < size_.height_px; y += kTileY) {
        for (int x = 0; x < size_.width_px; x += kTileX) {
          if (tile++ % threads_ == thread) {
            windows(x, y, scratch);
          }
        }
      }
      barrier.arrive_and_wait();
      const double middle = seconds();
      double rz = total(thread, start_search(first, last), barrier);
      for (int iteration = 0; iteration < options_.cg_iterations; ++iteration) {
        const double curvature = total(thread, products(first, last), barrier);
        const float alpha = curvature > 0 && rz > 0 ? static_cast<float>(rz / curvature) : 0;
        const double next = total(thread, descend(first, last, alpha), barrier);
        const float beta = rz > 0 ? static_cast<float>(next / rz) : 0;
        rz = next;
        for (std::size_t i = first; i < last; ++i) {
          search_[i] = inverse_[i] * residual_[i] + beta * search_[i];
        }
        barrier.arrive_and_wait();
      }
      const float most = options_.most_move_px;
      for (std::size_t i = first; i < last; ++i) {
        field_[i] += std::clamp(update_[i], -most, most);
      }
      barrier.arrive_and_wait();
      if (thread == 0) {
        out.windows_ms += middle - begin;
        out.solve_ms += seconds() - middle;
      }
    }
  }

  struct Scratch {
    Scratch(int slots, int rx, int ry)
        : width(kTileX + 2 * rx),
          rows(kTileY + 2 * ry),
          samples(kSamples * static_cast<std::size_t>(slots * rows * width)),
          sums_x(kSumsX * static_cast<std::size_t>(slots * rows * kTileX)),
          sums_xy(kSumsXY * static_cast<std::size_t>(slots * kTileY * kTileX)) {}
    int width, rows;
    Floats samples, sums_x, sums_xy;
  };

  /// J and b of the windows of one tile in all slots.
  void windows(int x0, int y0, Scratch& scratch) {
    const int columns = std::min(kTileX, size_.width_px - x0);
    const int rows = std::min(kTileY, size_.height_px - y0);
    for (int t = 0; t < size_.slots; ++t) {
      for (int row = 0; row < rows + 2 * ry_; ++row) {
        sample_row(x0, y0 - ry_ + row, t, scratch, row);
        sum_x(t, row, scratch);
      }
      for (int row = 0; row < rows; ++row) {
        sum_y(t, row, scratch);
      }
    }
    for (int t = 0; t < size_.slots; ++t) {
      for (int row = 0; row < rows; ++row) {
        equations(x0, y0 + row, t, columns, row, scratch);
      }
    }
  }

  float* samples(Scratch& scratch, int t, int row) const {
    return scratch.samples.data() +
           kSamples * static_cast<std::size_t>((t * scratch.rows + row) * scratch.width);
  }

  void sample_row(int x0, int y, int t, Scratch& scratch, int row) const {
    float* counted = samples(scratch, t, row);
    float* l = counted + scratch.width;
    float* w = l + scratch.width;
    float* h = w + scratch.width;
    float* d = h + scratch.width;
    std::fill(counted, counted + kSamples * static_cast<std::size_t>(scratch.width), 0.0F);
    if (y < 0 || y >= size_.height_px) {
      return;
    }
    const std::size_t first = size_.voxel(0, y, t);
    const float* left = left_.data() + first;
    const float* right = right_.data() + first;
    const float* field = field_.data() + pad_ + first;
    const float* solved = solved_.data() + pad_ + first;
    const int begin = std::max(1, x0 - rx_);
    const int end = std::min(size_.width_px - 1, x0 - rx_ + scratch.width);
    for (int x = begin; x < end; ++x) {
      const int i = x - (x0 - rx_);
      const float from = static_cast<float>(x) - field[x];
      const float corner = std::floor(from);
      const auto c = static_cast<int>(corner);
      if (solved[x] == 0 || c < 1 || c + 2 >= size_.width_px) {
        continue;
      }
      const float a = right[c - 1], b = right[c], e = right[c + 1], g = right[c + 2];
      if (std::min({a, b, e, g, left[x - 1], left[x], left[x + 1]}) < 0) {
        continue;
      }
      const float f = from - corner, f2 = f * f, f3 = f2 * f;
      counted[i] = 1;
      l[i] = (left[x - 1] + 4 * left[x] + left[x + 1]) / 6 - 0.5F;
      w[i] = (a * (1 - 3 * f + 3 * f2 - f3) + b * (4 - 6 * f2 + 3 * f3) + e * (1 + 3 * f + 3 * f2 - 3 * f3) +
              g * f3) /
                 6 -
             0.5F;
      h[i] = -(a * (-1 + 2 * f - f2) + b * (-4 * f + 3 * f2) + e * (1 + 2 * f - 3 * f2) + g * f2) / 2;
      d[i] = field[x];
    }
  }

  void sum_x(int t, int row, Scratch& scratch) const {
    const float* counted = samples(scratch, t, row);
    const float* l = counted + scratch.width;
    const float* w = l + scratch.width;
    const float* h = w + scratch.width;
    const float* d = h + scratch.width;
    float* out = scratch.sums_x.data() + kSumsX * static_cast<std::size_t>((t * scratch.rows + row) * kTileX);
    std::fill(out, out + kSumsX * kTileX, 0.0F);
    for (int k = 0; k <= 2 * rx_; ++k) {
      const auto u = static_cast<float>(k - rx_);
      for (int i = 0; i < kTileX; ++i) {
        const float sl = l[i + k], sw = w[i + k], sh = h[i + k], sd = d[i + k];
        const float hw = sh * sw, hl = sh * sl, hh = sh * sh, hd = sh * sd, hhd = hd * sh, hhu = hh * u;
        out[i] += counted[i + k];
        out[kTileX + i] += sl;
        out[2 * kTileX + i] += sw;
        out[3 * kTileX + i] += sl * sl;
        out[4 * kTileX + i] += sl * sw;
        out[5 * kTileX + i] += sw * sw;
        out[6 * kTileX + i] += hd;
        out[7 * kTileX + i] += hd * sw;
        out[8 * kTileX + i] += sh;
        out[9 * kTileX + i] += sh * u;
        out[10 * kTileX + i] += hw;
        out[11 * kTileX + i] += hw * u;
        out[12 * kTileX + i] += hl;
        out[13 * kTileX + i] += hl * u;
        out[14 * kTileX + i] += hhd;
        out[15 * kTileX + i] += hhd * u;
        out[16 * kTileX + i] += hh;
        out[17 * kTileX + i] += hhu;
        out[18 * kTileX + i] += hhu * u;
        out[19 * kTileX + i] += hd * hd;
      }
    }
  }

  /// 0 1 l w ll lw ww hd hdw, 8 h hu hv, 11 hw.., 14 hl.., 17 hhd.., 20 hhdd, 21 hh hhu hhv hhuu hhuv hhvv
  void sum_y(int t, int row, Scratch& scratch) const {
    float* out = scratch.sums_xy.data() + kSumsXY * static_cast<std::size_t>((t * kTileY + row) * kTileX);
    std::fill(out, out + kSumsXY * kTileX, 0.0F);
    for (int k = 0; k <= 2 * ry_; ++k) {
      const float* in =
          scratch.sums_x.data() + kSumsX * static_cast<std::size_t>((t * scratch.rows + row + k) * kTileX);
      const auto v = static_cast<float>(k - ry_);
      const auto add = [&](int to, int from, float factor) {
        for (int i = 0; i < kTileX; ++i) {
          out[to * kTileX + i] += factor * in[from * kTileX + i];
        }
      };
      for (int plain = 0; plain < 8; ++plain) {
        add(plain, plain, 1);
      }
      for (int group = 0; group < 4; ++group) {  // h, hw, hl, hhd
        add(8 + 3 * group, 8 + 2 * group, 1);
        add(9 + 3 * group, 9 + 2 * group, 1);
        add(10 + 3 * group, 8 + 2 * group, v);
      }
      add(20, 19, 1);
      add(21, 16, 1);
      add(22, 17, 1);
      add(23, 16, v);
      add(24, 18, 1);
      add(25, 17, v);
      add(26, 16, v * v);
    }
  }

  void equations(int x0, int y, int t, int columns, int row, Scratch& scratch) {
    std::array<std::array<float, kTileX>, 37> sum{};  // sum_y's, then hs hws hls hhds hhs hhus hhvs hhss
    for (int k = -rt_; k <= rt_; ++k) {
      if (t + k < 0 || t + k >= size_.slots) {
        continue;
      }
      const float* in =
          scratch.sums_xy.data() + kSumsXY * static_cast<std::size_t>(((t + k) * kTileY + row) * kTileX);
      const auto s = static_cast<float>(k);
      for (std::size_t j = 0; j < kSumsXY; ++j) {
        for (std::size_t i = 0; i < kTileX; ++i) {
          sum[j][i] += in[j * kTileX + i];
        }
      }
      constexpr std::array<std::size_t, 8> source{8, 11, 14, 17, 21, 22, 23, 21};
      for (std::size_t j = 0; j < source.size(); ++j) {
        const float factor = j == 7 ? s * s : s;
        for (std::size_t i = 0; i < kTileX; ++i) {
          sum[kSumsXY + j][i] += factor * in[source[j] * kTileX + i];
        }
      }
    }
    const std::size_t first = pad_ + size_.voxel(x0, y, t);
    const float least_count = 0.5F * static_cast<float>(options_.window_x * options_.window_y);
    for (int column = 0; column < columns; ++column) {
      const auto i = static_cast<std::size_t>(column);
      const std::size_t at = first + i;
      const float n = std::max(sum[0][i], 1.0F);
      const float inverse_n = 1 / n;
      const float mean_l = sum[1][i] * inverse_n, mean_w = sum[2][i] * inverse_n;
      const float ll = sum[3][i] - sum[1][i] * mean_l, lw = sum[4][i] - sum[1][i] * mean_w,
                  ww = sum[5][i] - sum[2][i] * mean_w;
      const float least = options_.least_texture * options_.least_texture * n;
      const bool speaks =
          solved_[at] != 0 && sum[0][i] >= least_count && ll >= least && ww >= least && lw > 0;
      const float inverse_ww = 1 / std::max(ww, 1e-12F);
      const float gain = lw * inverse_ww;
      const float residual = std::max(ll - lw * gain, 0.0F);
      const float weight = speaks ? 1 / (residual * inverse_n + options_.noise * options_.noise) : 0;
      std::array<float, 4> p{field_[at], 0, 0, 0};
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const float a = after_[axis][at], b = before_[axis][at];
        p[axis + 1] = a * field_[at + static_cast<std::size_t>(stride_[axis])] + (b - a) * field_[at] -
                      b * field_[at - static_cast<std::size_t>(stride_[axis])];
      }
      const std::array<float, 4> h{sum[8][i], sum[9][i], sum[10][i], sum[27][i]};
      const std::array<float, 4> hw{sum[11][i], sum[12][i], sum[13][i], sum[28][i]};
      const std::array<float, 4> hl{sum[14][i], sum[15][i], sum[16][i], sum[29][i]};
      const std::array<float, 4> hhd{sum[17][i], sum[18][i], sum[19][i], sum[30][i]};
      const std::array<std::array<float, 4>, 4> m{{{sum[21][i], sum[22][i], sum[23][i], sum[31][i]},
                                                   {sum[22][i], sum[24][i], sum[25][i], sum[32][i]},
                                                   {sum[23][i], sum[25][i], sum[26][i], sum[33][i]},
                                                   {sum[31][i], sum[32][i], sum[33][i], sum[34][i]}}};
      float spread = sum[20][i];
      for (std::size_t a = 0; a < 4; ++a) {
        float row_sum = -2 * hhd[a];
        for (std::size_t b = 0; b < 4; ++b) {
          row_sum += m[a][b] * p[b];
        }
        spread += p[a] * row_sum;
      }
      spread = std::max(spread, 0.0F) / std::max(m[0][0], 1e-12F);
      const float bend = 1 / (1 + spread / (options_.straddle_px * options_.straddle_px));
      const float scale = weight * gain * gain;
      const float hdw = sum[7][i] - mean_w * sum[6][i];
      std::size_t entry = 0;
      std::array<float, 4> jp{};
      for (std::size_t a = 0; a < 4; ++a) {
        for (std::size_t b = a; b < 4; ++b) {
          const float value = scale * (m[a][b] - h[a] * h[b] * inverse_n -
                                       (hw[a] - mean_w * h[a]) * (hw[b] - mean_w * h[b]) * inverse_ww);
          hessian_[entry++][at] = value;
          jp[a] += value * p[b];
          jp[b] += a == b ? 0 : value * p[a];
        }
      }
      for (std::size_t a = 0; a < 4; ++a) {
        const float centred_w = hw[a] - mean_w * h[a];
        const float move =
            jp[a] - scale * (hhd[a] - h[a] * inverse_n * sum[6][i] - centred_w * inverse_ww * hdw);
        gradient_[a][at] = bend * move - weight * gain * (hl[a] - mean_l * h[a] - gain * centred_w);
      }
    }
  }

  /// [I; Gx; Gy; Gt]^T of gradient_ at a voxel.
  float adjoint(std::size_t at) const {
    float sum = gradient_[0][at];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto stride = static_cast<std::size_t>(stride_[axis]);
      const Floats& q = gradient_[axis + 1];
      sum += (before_[axis][at] - after_[axis][at]) * q[at] - before_[axis][at + stride] * q[at + stride] +
             after_[axis][at - stride] * q[at - stride];
    }
    return sum;
  }

  double start_search(std::size_t first, std::size_t last) {
    constexpr std::array<std::size_t, 3> squares{4, 7, 9};
    double rz = 0;
    for (std::size_t at = first; at < last; ++at) {
      std::array<float, 3> own{};
      float diagonal = hessian_[0][at] + options_.damping;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const auto stride = static_cast<std::size_t>(stride_[axis]);
        own[axis] = before_[axis][at] - after_[axis][at];
        const float next = before_[axis][at + stride], previous = after_[axis][at - stride];
        diagonal += next * next * hessian_[squares[axis]][at + stride] +
                    previous * previous * hessian_[squares[axis]][at - stride] +
                    own[axis] * own[axis] * hessian_[squares[axis]][at] +
                    2 * own[axis] * hessian_[axis + 1][at];
      }
      diagonal += 2 * (own[0] * own[1] * hessian_[5][at] + own[0] * own[2] * hessian_[6][at] +
                       own[1] * own[2] * hessian_[8][at]);
      inverse_[at] = solved_[at] / diagonal;
      residual_[at] = -adjoint(at);
      update_[at] = 0;
      search_[at] = inverse_[at] * residual_[at];
      rz += static_cast<double>(residual_[at] * search_[at]);
    }
    return rz;
  }

  /// gradient_ = J [I; G] search; returns search . A search.
  double products(std::size_t first, std::size_t last) {
    double curvature = 0;
    constexpr std::size_t piece = 1024;
    for (std::size_t begin = first; begin < last; begin += piece) {
      float sum = 0;
      for (std::size_t at = begin; at < std::min(last, begin + piece); ++at) {
        const float s0 = search_[at];
        const auto slope = [&](std::size_t axis) {
          const auto stride = static_cast<std::size_t>(stride_[axis]);
          const float a = after_[axis][at], b = before_[axis][at];
          return a * search_[at + stride] + (b - a) * s0 - b * search_[at - stride];
        };
        const float s1 = slope(0), s2 = slope(1), s3 = slope(2);
        const auto j = [&](std::size_t entry) { return hessian_[entry][at]; };
        const float q0 = j(0) * s0 + j(1) * s1 + j(2) * s2 + j(3) * s3;
        const float q1 = j(1) * s0 + j(4) * s1 + j(5) * s2 + j(6) * s3;
        const float q2 = j(2) * s0 + j(5) * s1 + j(7) * s2 + j(8) * s3;
        const float q3 = j(3) * s0 + j(6) * s1 + j(8) * s2 + j(9) * s3;
        gradient_[0][at] = q0;
        gradient_[1][at] = q1;
        gradient_[2][at] = q2;
        gradient_[3][at] = q3;
        sum += s0 * q0 + s1 * q1 + s2 * q2 + s3 * q3 + options_.damping * s0 * s0;
      }
      curvature += static_cast<double>(sum);
    }
    return curvature;
  }

  double descend(std::size_t first, std::size_t last, float alpha) {
    double rz = 0;
    constexpr std::size_t piece = 1024;
    for (std::size_t begin = first; begin < last; begin += piece) {
      float sum = 0;
      for (std::size_t at = begin; at < std::min(last, begin + piece); ++at) {
        update_[at] += alpha * search_[at];
        residual_[at] -= alpha * (adjoint(at) + options_.damping * search_[at]);
        sum += residual_[at] * residual_[at] * inverse_[at];
      }
      rz += static_cast<double>(sum);
    }
    return rz;
  }

  stereo::VolumeSize size_;
  stereo::SpacetimeOptions options_;
  std::span<const float> left_, right_;
  int threads_;
  std::size_t pad_;
  int rx_, ry_, rt_;
  std::array<std::ptrdiff_t, 3> stride_{};
  Floats field_, residual_, inverse_, search_, update_, solved_;
  std::array<Floats, 3> after_, before_;  ///< of a difference: weight of the voxel after, of the one before
  std::array<Floats, 10> hessian_;        ///< J00 J01 J02 J03 J11 J12 J13 J22 J23 J33
  std::array<Floats, 4> gradient_;        ///< b, then J [I; G] search
  std::vector<double> partial_;
};

}  // namespace

VectorStereoResult solve_on_vectors(const stereo::VolumeSize& size, std::span<const float> left,
                                    std::span<const float> right, std::span<const float> start_px,
                                    const stereo::SpacetimeOptions& options, int threads) {
  return Solver(size, left, right, start_px, options, threads).run();
}

}  // namespace facet::bench
