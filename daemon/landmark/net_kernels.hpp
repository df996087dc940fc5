#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "landmark/tflite_model.hpp"

namespace facet::landmark {

/// Channels are worked on in groups of so many.
inline constexpr int kLanes = 8;

/// The extents of a picture of channels, [rows][columns][stride]: a pixel's channels, then zeros up to the
/// next multiple of kLanes.
struct Extents {
  int rows = 0;
  int columns = 0;
  int channels = 0;

  std::size_t pixels() const { return static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns); }
  std::size_t stride() const { return (static_cast<std::size_t>(channels) + kLanes - 1) / kLanes * kLanes; }
  bool operator==(const Extents&) const = default;
};

/// A window that moves over a picture.
struct Window {
  int rows = 1;
  int columns = 1;
  int row_stride = 1;
  int column_stride = 1;
  int top = 0;   ///< rows of padding before the first
  int left = 0;  ///< columns likewise
};

/// The window of an operator over a picture and the picture that comes of it, as TensorFlow defines SAME and
/// VALID; out has no rows or columns where the window does not fit into the picture.
Window window_over(const TfliteOperator& op, int rows, int columns, const Extents& in, Extents& out);

/// What is done with a convolution's sums before they are stored; null: left out. Sums of channels, all
/// [stride].
struct Finish {
  const float* bias = nullptr;
  const float* added = nullptr;   ///< [pixel][stride], a picture as large as the result
  const float* slopes = nullptr;  ///< of negative values (PReLU); zeros: ReLU
};

/// A matrix of weights, packed for multiply.
class PackedWeights {
 public:
  /// weights: [outputs][depth].
  PackedWeights(std::span<const float> weights, int outputs, int depth);

  std::size_t depth() const { return depth_; }
  std::size_t groups() const { return groups_; }  ///< of kLanes outputs
  /// [depth][kLanes] of two groups side by side, of the last alone where their number is odd.
  const float* data() const { return values_.data(); }

 private:
  std::size_t depth_;
  std::size_t groups_;
  std::vector<float> values_;
};

/// out = finish(weights * in), pixel by pixel.
///
/// in          [count][in_stride], the first weights.depth() of each count
/// out         [count][groups * kLanes]
void multiply(const float* in, std::size_t in_stride, std::size_t count, const PackedWeights& weights,
              const Finish& finish, float* out);

/// The pixels under the window at every place of one row of the result, one after the other:
/// [out.columns][window.rows][window.columns][channels], zeros beyond the picture, and kLanes zeros.
void gather_row(const float* in, const Extents& extents, const Window& window, const Extents& out, int row,
                float* patches);

/// Every channel by itself: weights [window.rows * window.columns][stride].
void convolve_depthwise(const float* in, const Extents& extents, const Window& window, const float* weights,
                        const Finish& finish, const Extents& out, float* result);

/// The largest of each channel under the window, as far as it lies in the picture.
void pool_largest(const float* in, const Extents& extents, const Window& window, const Extents& out,
                  float* result);

/// result[i] = finish of in[i], element by element.
void apply(const float* in, const Extents& extents, const Finish& finish, float* result);

}  // namespace facet::landmark
