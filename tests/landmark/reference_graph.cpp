#include "reference_graph.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "landmark/landmark_layout.hpp"

namespace facet::test {
namespace {

using landmark::OperatorKind;
using landmark::PaddingMode;
using landmark::TfliteModel;
using landmark::TfliteOperator;

struct Tensor {
  std::vector<int> shape;
  std::vector<float> values;

  float at(int row, int column, int channel) const {
    return values[static_cast<std::size_t>((row * shape[2] + column) * shape[3] + channel)];
  }
  float& at(int row, int column, int channel) {
    return values[static_cast<std::size_t>((row * shape[2] + column) * shape[3] + channel)];
  }
};

/// Rows or columns of padding before the first, as TensorFlow defines SAME.
int pad_before(PaddingMode mode, int in, int out, int kernel, int stride) {
  return mode == PaddingMode::Valid ? 0 : std::max(0, (out - 1) * stride + kernel - in) / 2;
}

/// Calls body(out row, out column, in row, in column, kernel row, kernel column) for every pair inside the
/// image.
template <typename Body>
void for_window(const Tensor& in, const Tensor& out, int kernel_rows, int kernel_columns,
                const TfliteOperator& op, Body body) {
  const int top = pad_before(op.padding, in.shape[1], out.shape[1], kernel_rows, op.stride_rows);
  const int left = pad_before(op.padding, in.shape[2], out.shape[2], kernel_columns, op.stride_columns);
  for (int y = 0; y < out.shape[1]; ++y) {
    for (int x = 0; x < out.shape[2]; ++x) {
      for (int ky = 0; ky < kernel_rows; ++ky) {
        for (int kx = 0; kx < kernel_columns; ++kx) {
          const int iy = y * op.stride_rows + ky - top;
          const int ix = x * op.stride_columns + kx - left;
          if (iy >= 0 && ix >= 0 && iy < in.shape[1] && ix < in.shape[2]) {
            body(y, x, iy, ix, ky, kx);
          }
        }
      }
    }
  }
}

class Interpreter {
 public:
  explicit Interpreter(const TfliteModel& model) : model_(model), tensors_(model.tensors.size()) {
    for (std::size_t i = 0; i < tensors_.size(); ++i) {
      const auto& tensor = model.tensors[i];
      tensors_[i].shape = tensor.shape;
      const bool number =
          tensor.type == landmark::TensorType::Float32 || tensor.type == landmark::TensorType::Float16;
      if (number && !tensor.data.empty()) {
        tensors_[i].values = model.constant_floats(static_cast<int>(i));
      } else {
        tensors_[i].values.assign(tensor.element_count(), 0.0F);
      }
    }
  }

  Tensor& tensor(int index) { return tensors_.at(static_cast<std::size_t>(index)); }

  void run(const TfliteOperator& op) {
    const Tensor& in = tensor(op.inputs[0]);
    Tensor& out = tensor(op.outputs[0]);
    switch (op.kind) {
      case OperatorKind::Dequantize:
      case OperatorKind::Reshape:
        out.values = in.values;
        break;
      case OperatorKind::Relu:
        std::transform(in.values.begin(), in.values.end(), out.values.begin(),
                       [](float v) { return std::max(v, 0.0F); });
        break;
      case OperatorKind::Add:
        std::transform(in.values.begin(), in.values.end(), tensor(op.inputs[1]).values.begin(),
                       out.values.begin(), [](float a, float b) { return a + b; });
        break;
      case OperatorKind::Prelu: {
        const std::vector<float>& slopes = tensor(op.inputs[1]).values;
        for (std::size_t i = 0; i < in.values.size(); ++i) {
          out.values[i] = in.values[i] < 0 ? in.values[i] * slopes[i % slopes.size()] : in.values[i];
        }
        break;
      }
      case OperatorKind::Conv2d:
        convolve(op, in, out);
        break;
      case OperatorKind::DepthwiseConv2d:
        convolve_depthwise(op, in, out);
        break;
      case OperatorKind::MaxPool2d:
        std::fill(out.values.begin(), out.values.end(), std::numeric_limits<float>::lowest());
        for_window(in, out, op.filter_rows, op.filter_columns, op,
                   [&](int y, int x, int iy, int ix, int, int) {
                     for (int c = 0; c < out.shape[3]; ++c) {
                       out.at(y, x, c) = std::max(out.at(y, x, c), in.at(iy, ix, c));
                     }
                   });
        break;
      case OperatorKind::Pad: {
        const std::vector<int> widths = model_.constant_ints(op.inputs[1]);
        std::fill(out.values.begin(), out.values.end(), 0.0F);
        for (int y = 0; y < in.shape[1]; ++y) {
          for (int x = 0; x < in.shape[2]; ++x) {
            for (int c = 0; c < in.shape[3]; ++c) {
              out.at(y + widths[2], x + widths[4], c + widths[6]) = in.at(y, x, c);
            }
          }
        }
        break;
      }
      case OperatorKind::Concatenation:
        concatenate(op, out);
        break;
      case OperatorKind::Mul: {
        const std::vector<float>& factors = tensor(op.inputs[1]).values;
        for (std::size_t i = 0; i < in.values.size(); ++i) {
          out.values[i] = in.values[i] * factors[i % factors.size()];
        }
        break;
      }
      case OperatorKind::StridedSlice:  // the nets have it only round whole tensors
        out.values = in.values;
        break;
      case OperatorKind::Custom:
        run_custom(op, in, out);
        break;
      default:
        throw std::logic_error("the reference does not know this operator");
    }
  }

 private:
  void convolve(const TfliteOperator& op, const Tensor& in, Tensor& out) {
    const Tensor& weights = tensor(op.inputs[1]);
    const Tensor& bias = tensor(op.inputs[2]);
    const int channels = in.shape[3];
    const int outputs = out.shape[3];
    for (std::size_t i = 0; i < out.values.size(); ++i) {
      out.values[i] = bias.values[i % bias.values.size()];
    }
    for_window(in, out, weights.shape[1], weights.shape[2], op,
               [&](int y, int x, int iy, int ix, int ky, int kx) {
                 for (int o = 0; o < outputs; ++o) {
                   float sum = 0;
                   for (int c = 0; c < channels; ++c) {
                     const int w = ((o * weights.shape[1] + ky) * weights.shape[2] + kx) * channels + c;
                     sum += in.at(iy, ix, c) * weights.values[static_cast<std::size_t>(w)];
                   }
                   out.at(y, x, o) += sum;
                 }
               });
  }

  void convolve_depthwise(const TfliteOperator& op, const Tensor& in, Tensor& out) {
    const Tensor& weights = tensor(op.inputs[1]);
    const Tensor& bias = tensor(op.inputs[2]);
    for (std::size_t i = 0; i < out.values.size(); ++i) {
      out.values[i] = bias.values[i % bias.values.size()];
    }
    for_window(in, out, weights.shape[1], weights.shape[2], op,
               [&](int y, int x, int iy, int ix, int ky, int kx) {
                 for (int c = 0; c < out.shape[3]; ++c) {
                   out.at(y, x, c) += in.at(iy, ix, c) * weights.at(ky, kx, c);
                 }
               });
  }

  void concatenate(const TfliteOperator& op, Tensor& out) {
    const auto axis = static_cast<std::size_t>(op.axis);
    std::size_t outer = 1;
    for (std::size_t i = 0; i < axis; ++i) {
      outer *= static_cast<std::size_t>(out.shape[i]);
    }
    out.values.clear();
    for (std::size_t block = 0; block < outer; ++block) {
      for (const int input : op.inputs) {
        const std::vector<float>& values = tensor(input).values;
        const auto size = static_cast<std::ptrdiff_t>(values.size() / outer);
        const auto begin = values.begin() + static_cast<std::ptrdiff_t>(block) * size;
        out.values.insert(out.values.end(), begin, begin + size);
      }
    }
  }

  /// MediaPipe's own operators, version 2, as 4 x 4 matrices: image = matrix * crop.
  void run_custom(const TfliteOperator& op, const Tensor& in, Tensor& out) {
    if (op.custom_name == "Landmarks2TransformMatrix") {
      out.values = crop_matrix(in.values);
    } else if (op.custom_name == "TransformTensorBilinear") {
      sample_crop(in, tensor(op.inputs[1]).values, out);
    } else if (op.custom_name == "TransformLandmarks") {
      const std::vector<float>& m = tensor(op.inputs[1]).values;
      for (std::size_t i = 0; i + 1 < in.values.size(); i += 2) {
        out.values[i] = m[0] * in.values[i] + m[1] * in.values[i + 1] + m[3];
        out.values[i + 1] = m[4] * in.values[i] + m[5] * in.values[i + 1] + m[7];
      }
    } else {
      throw std::logic_error("the reference does not know this custom operator");
    }
  }

  /// Centre, turn by the corners, 1.5 times the extent, over 16 pixels. The graph asks for the lips, the
  /// right and the left eye, in this order.
  std::vector<float> crop_matrix(const std::vector<float>& landmarks) {
    struct Part {
      std::span<const int> members;
      int from, to;
    };
    const Part parts[] = {{landmark::lip_landmarks(), 61, 291},
                          {landmark::right_eye_landmarks(), 33, 133},
                          {landmark::left_eye_landmarks(), 362, 263}};
    const Part& part = parts[crops_++ % 3];
    const auto x = [&](int i) { return landmarks[static_cast<std::size_t>(3 * i)]; };
    const auto y = [&](int i) { return landmarks[static_cast<std::size_t>(3 * i + 1)]; };
    const float turn = -std::atan2(y(part.to) - y(part.from), x(part.to) - x(part.from));
    float left = 1e9F, right = -1e9F, top = 1e9F, bottom = -1e9F;
    for (const int i : part.members) {
      const float u = std::cos(turn) * x(i) - std::sin(turn) * y(i);
      const float v = std::sin(turn) * x(i) + std::cos(turn) * y(i);
      left = std::min(left, u);
      right = std::max(right, u);
      top = std::min(top, v);
      bottom = std::max(bottom, v);
    }
    const float u = (left + right) / 2;
    const float v = (top + bottom) / 2;
    Eigen::Affine2f matrix = Eigen::Translation2f(std::cos(-turn) * u - std::sin(-turn) * v,
                                                  std::sin(-turn) * u + std::cos(-turn) * v) *
                             Eigen::Rotation2Df(-turn) *
                             Eigen::Scaling(1.5F * (right - left) / 16, 1.5F * (bottom - top) / 16) *
                             Eigen::Translation2f(-8, -8);
    const auto& m = matrix.matrix();
    return {m(0, 0), m(0, 1), 0, m(0, 2), m(1, 0), m(1, 1), 0, m(1, 2), 0, 0, 1, 0, 0, 0, 0, 1};
  }

  static void sample_crop(const Tensor& in, const std::vector<float>& m, Tensor& out) {
    for (int row = 0; row < out.shape[1]; ++row) {
      for (int column = 0; column < out.shape[2]; ++column) {
        const float cx = static_cast<float>(column) + 0.5F;
        const float cy = static_cast<float>(row) + 0.5F;
        const float x = m[0] * cx + m[1] * cy + m[3] - 0.5F;
        const float y = m[4] * cx + m[5] * cy + m[7] - 0.5F;
        const bool outside = x < 0 || y < 0 || x > static_cast<float>(in.shape[2] - 1) ||
                             y > static_cast<float>(in.shape[1] - 1);
        for (int c = 0; c < out.shape[3]; ++c) {
          float sum = 0;
          for (int dy = 0; dy < 2 && !outside; ++dy) {
            for (int dx = 0; dx < 2; ++dx) {
              const int ix = static_cast<int>(std::floor(x)) + dx;
              const int iy = static_cast<int>(std::floor(y)) + dy;
              if (ix < in.shape[2] && iy < in.shape[1]) {
                sum += (1 - std::abs(x - static_cast<float>(ix))) *
                       (1 - std::abs(y - static_cast<float>(iy))) * in.at(iy, ix, c);
              }
            }
          }
          out.at(row, column, c) = sum;
        }
      }
    }
  }

  const TfliteModel& model_;
  std::vector<Tensor> tensors_;
  std::size_t crops_ = 0;
};

}  // namespace

std::vector<std::vector<float>> run_reference(const TfliteModel& model, std::span<const float> image) {
  Interpreter interpreter(model);
  interpreter.tensor(model.inputs[0]).values.assign(image.begin(), image.end());
  for (const TfliteOperator& op : model.operators) {
    interpreter.run(op);
  }
  std::vector<std::vector<float>> outputs;
  outputs.reserve(model.outputs.size());
  for (const int output : model.outputs) {
    outputs.push_back(interpreter.tensor(output).values);
  }
  return outputs;
}

}  // namespace facet::test
