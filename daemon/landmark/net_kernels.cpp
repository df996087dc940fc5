#include "landmark/net_kernels.hpp"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>

namespace facet::landmark {
namespace {

using Float8 = float __attribute__((vector_size(32)));
static_assert(sizeof(Float8) == kLanes * sizeof(float));

// From and to floats anywhere in memory: one instruction, not a call.
Float8 load(const float* from) {
  Float8 values;
  std::memcpy(&values, from, sizeof values);
  return values;
}
void store(Float8 values, float* to) {
  std::memcpy(to, &values, sizeof values);
}
Float8 larger(Float8 a, Float8 b) {
  return a > b ? a : b;
}
Float8 smaller(Float8 a, Float8 b) {
  return a < b ? a : b;
}

/// channel: the first of the group; pixel: of the result, in floats.
void finish_group(Float8 sum, const Finish& finish, std::size_t channel, std::size_t pixel, float* out) {
  if (finish.added != nullptr) {
    sum += load(finish.added + pixel + channel);
  }
  if (finish.slopes != nullptr) {
    const Float8 zero{};
    sum = larger(sum, zero) + load(finish.slopes + channel) * smaller(sum, zero);
  }
  store(sum, out + pixel + channel);
}

/// How many pixels share a look at the weights: sums of so many and two groups of channels fill the
/// registers.
constexpr int kPixels = 6;

/// What multiply was given.
struct Product {
  const float* in;
  std::size_t in_stride;
  const PackedWeights& weights;
  const Finish& finish;
  float* out;
};

/// kCount pixels from `first` on times kGroups groups of outputs from `group` on.
template <int kCount, int kGroups>
void multiply_tile(const Product& product, std::size_t first, std::size_t group) {
  const std::size_t depth = product.weights.depth();
  const std::size_t in_stride = product.in_stride;
  const float* const in = product.in + first * in_stride;
  const float* weights = product.weights.data() + group * kLanes * depth;
  const std::size_t channel = group * kLanes;
  Float8 sums[kCount][kGroups];
  for (int p = 0; p < kCount; ++p) {
    for (int g = 0; g < kGroups; ++g) {
      sums[p][g] = load(product.finish.bias + channel + static_cast<std::size_t>(g) * kLanes);
    }
  }
  for (std::size_t k = 0; k < depth; ++k) {
    Float8 factors[kGroups];
    for (int g = 0; g < kGroups; ++g) {
      factors[g] = load(weights + static_cast<std::size_t>(g) * kLanes);
    }
    weights += std::size_t{kGroups} * kLanes;
    for (int p = 0; p < kCount; ++p) {
      const float value = in[static_cast<std::size_t>(p) * in_stride + k];
      for (int g = 0; g < kGroups; ++g) {
        sums[p][g] += value * factors[g];
      }
    }
  }
  const std::size_t out_stride = product.weights.groups() * kLanes;
  for (int p = 0; p < kCount; ++p) {
    for (int g = 0; g < kGroups; ++g) {
      finish_group(sums[p][g], product.finish, channel + static_cast<std::size_t>(g) * kLanes,
                   (first + static_cast<std::size_t>(p)) * out_stride, product.out);
    }
  }
}

using Tile = void (*)(const Product&, std::size_t, std::size_t);
/// [pixels - 1][groups - 1]
constexpr std::array<std::array<Tile, 2>, kPixels> kTiles = {{
    {multiply_tile<1, 1>, multiply_tile<1, 2>},
    {multiply_tile<2, 1>, multiply_tile<2, 2>},
    {multiply_tile<3, 1>, multiply_tile<3, 2>},
    {multiply_tile<4, 1>, multiply_tile<4, 2>},
    {multiply_tile<5, 1>, multiply_tile<5, 2>},
    {multiply_tile<6, 1>, multiply_tile<6, 2>},
}};

/// The places of the window that lie in the picture, along one axis: [first, end).
struct Inside {
  Inside(int place, int stride, int before, int window, int extent)
      : origin(place * stride - before),
        first(std::max(0, -origin)),
        end(std::min(window, extent - origin)) {}

  int origin;  ///< of the window in the picture
  int first;
  int end;
};

std::size_t offset_of(const Extents& extents, int row, int column) {
  return (static_cast<std::size_t>(row) * static_cast<std::size_t>(extents.columns) +
          static_cast<std::size_t>(column)) *
         extents.stride();
}

/// Calls one(tap, first float of the pixel in the picture) for what of the window lies in the picture.
template <typename One>
void for_taps(const Extents& extents, const Window& window, const Inside& rows, const Inside& columns,
              const One& one) {
  for (int y = rows.first; y < rows.end; ++y) {
    for (int x = columns.first; x < columns.end; ++x) {
      one(static_cast<std::size_t>(y * window.columns + x),
          offset_of(extents, rows.origin + y, columns.origin + x));
    }
  }
}

constexpr int kTaps = 3;

/// Floats from one place of the window to the next.
struct Steps {
  std::size_t row;     ///< of the picture
  std::size_t place;   ///< of the window, along a row of the result
  std::size_t stride;  ///< of a pixel
};

/// Pixels [first, end) of the result, all of one row, for windows of 3 x 3 that lie wholly in the picture:
/// the nine weights of a group of channels stay in registers.
///
/// in  the pixel under the window's first place at `first`
void convolve_three(const float* in, const Steps& steps, const float* weights, const Finish& finish,
                    std::size_t first, std::size_t end, float* result) {
  const std::size_t stride = steps.stride;
  for (std::size_t channel = 0; channel < stride; channel += kLanes) {
    Float8 taps[kTaps * kTaps];
    for (std::size_t t = 0; t < std::size_t{kTaps} * kTaps; ++t) {
      taps[t] = load(weights + t * stride + channel);
    }
    const Float8 bias = load(finish.bias + channel);
    const float* corner = in + channel;
    for (std::size_t x = first; x < end; ++x, corner += steps.place) {
      Float8 sum = bias;
      for (std::size_t y = 0; y < kTaps; ++y) {
        const float* pixel = corner + y * steps.row;
        sum += load(pixel) * taps[kTaps * y] + load(pixel + stride) * taps[kTaps * y + 1] +
               load(pixel + 2 * stride) * taps[kTaps * y + 2];
      }
      finish_group(sum, finish, channel, x * stride, result);
    }
  }
}

}  // namespace

Window window_over(const TfliteOperator& op, int rows, int columns, const Extents& in, Extents& out) {
  Window window{rows, columns, op.stride_rows, op.stride_columns, 0, 0};
  const auto along = [&](int extent, int size, int stride, int& before) {
    if (op.padding == PaddingMode::Valid) {
      return extent < size ? 0 : (extent - size) / stride + 1;
    }
    const int count = (extent + stride - 1) / stride;
    before = std::max(0, (count - 1) * stride + size - extent) / 2;
    return count;
  };
  out.rows = along(in.rows, rows, op.stride_rows, window.top);
  out.columns = along(in.columns, columns, op.stride_columns, window.left);
  return window;
}

PackedWeights::PackedWeights(std::span<const float> weights, int outputs, int depth)
    : depth_(static_cast<std::size_t>(depth)),
      groups_((static_cast<std::size_t>(outputs) + kLanes - 1) / kLanes),
      values_(groups_ * kLanes * depth_) {
  for (std::size_t o = 0; o < static_cast<std::size_t>(outputs); ++o) {
    const std::size_t pair = o / (std::size_t{2} * kLanes);
    const std::size_t lanes = std::min<std::size_t>(2, groups_ - 2 * pair) * kLanes;
    float* panel = values_.data() + pair * 2 * kLanes * depth_;
    for (std::size_t k = 0; k < depth_; ++k) {
      panel[k * lanes + o % (std::size_t{2} * kLanes)] = weights[o * depth_ + k];
    }
  }
}

void multiply(const float* in, std::size_t in_stride, std::size_t count, const PackedWeights& weights,
              const Finish& finish, float* out) {
  const Product product{in, in_stride, weights, finish, out};
  for (std::size_t first = 0; first < count; first += kPixels) {
    const std::size_t pixels = std::min<std::size_t>(kPixels, count - first);
    for (std::size_t group = 0; group < weights.groups(); group += 2) {
      const std::size_t groups = std::min<std::size_t>(2, weights.groups() - group);
      kTiles[pixels - 1][groups - 1](product, first, group);
    }
  }
}

void gather_row(const float* in, const Extents& extents, const Window& window, const Extents& out, int row,
                float* patches) {
  const auto channels = static_cast<std::size_t>(extents.channels);
  const std::size_t size =
      static_cast<std::size_t>(window.rows) * static_cast<std::size_t>(window.columns) * channels;
  const Inside rows(row, window.row_stride, window.top, window.rows, extents.rows);
  for (int column = 0; column < out.columns; ++column, patches += size) {
    const Inside columns(column, window.column_stride, window.left, window.columns, extents.columns);
    if (rows.end - rows.first < window.rows || columns.end - columns.first < window.columns) {
      std::fill_n(patches, size, 0.0F);
    }
    // What is copied beyond a pixel's channels is zeros, and the next one's place or kLanes behind all.
    for_taps(extents, window, rows, columns, [&](std::size_t tap, std::size_t from) {
      for (std::size_t channel = 0; channel < channels; channel += kLanes) {
        store(load(in + from + channel), patches + tap * channels + channel);
      }
    });
  }
}

void convolve_depthwise(const float* in, const Extents& extents, const Window& window, const float* weights,
                        const Finish& finish, const Extents& out, float* result) {
  const std::size_t stride = extents.stride();
  const auto slowly = [&](const Inside& rows, int row, int column) {
    const Inside columns(column, window.column_stride, window.left, window.columns, extents.columns);
    for (std::size_t channel = 0; channel < stride; channel += kLanes) {
      Float8 sum = load(finish.bias + channel);
      for_taps(extents, window, rows, columns, [&](std::size_t tap, std::size_t from) {
        sum += load(in + from + channel) * load(weights + tap * stride + channel);
      });
      finish_group(sum, finish, channel, offset_of(out, row, column), result);
    }
  };
  // Columns at which the window lies wholly in the picture.
  const int whole_first =
      std::min(out.columns, (window.left + window.column_stride - 1) / window.column_stride);
  const int last_origin = extents.columns - window.columns + window.left;
  const int whole_end = last_origin < 0
                            ? whole_first
                            : std::clamp(last_origin / window.column_stride + 1, whole_first, out.columns);
  for (int row = 0; row < out.rows; ++row) {
    const Inside rows(row, window.row_stride, window.top, window.rows, extents.rows);
    const bool fast = window.rows == kTaps && window.columns == kTaps && rows.end - rows.first == kTaps;
    const int first = fast ? whole_first : out.columns;
    const int end = fast ? whole_end : out.columns;
    for (int column = 0; column < first; ++column) {
      slowly(rows, row, column);
    }
    if (first < end) {
      const std::size_t place = offset_of(out, row, 0) / stride;
      convolve_three(in + offset_of(extents, rows.origin, first * window.column_stride - window.left),
                     {static_cast<std::size_t>(extents.columns) * stride,
                      static_cast<std::size_t>(window.column_stride) * stride, stride},
                     weights, finish, place + static_cast<std::size_t>(first),
                     place + static_cast<std::size_t>(end), result);
    }
    for (int column = end; column < out.columns; ++column) {
      slowly(rows, row, column);
    }
  }
}

void pool_largest(const float* in, const Extents& extents, const Window& window, const Extents& out,
                  float* result) {
  const std::size_t stride = extents.stride();
  const Float8 lowest = Float8{} + std::numeric_limits<float>::lowest();
  for (int row = 0; row < out.rows; ++row) {
    const Inside rows(row, window.row_stride, window.top, window.rows, extents.rows);
    for (int column = 0; column < out.columns; ++column) {
      const Inside columns(column, window.column_stride, window.left, window.columns, extents.columns);
      for (std::size_t channel = 0; channel < stride; channel += kLanes) {
        Float8 largest = lowest;
        for_taps(extents, window, rows, columns, [&](std::size_t, std::size_t from) {
          largest = larger(load(in + from + channel), largest);
        });
        store(largest, result + offset_of(out, row, column) + channel);
      }
    }
  }
}

void apply(const float* in, const Extents& extents, const Finish& finish, float* result) {
  const std::size_t stride = extents.stride();
  for (std::size_t pixel = 0; pixel < extents.pixels() * stride; pixel += stride) {
    for (std::size_t channel = 0; channel < stride; channel += kLanes) {
      finish_group(load(in + pixel + channel), finish, channel, pixel, result);
    }
  }
}

}  // namespace facet::landmark
