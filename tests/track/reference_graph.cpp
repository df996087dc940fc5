#include "reference_graph.hpp"

#include <algorithm>
#include <limits>
#include <stdexcept>

namespace facet::test {
namespace {

using track::OperatorKind;
using track::PaddingMode;
using track::TfliteModel;
using track::TfliteOperator;

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
          tensor.type == track::TensorType::Float32 || tensor.type == track::TensorType::Float16;
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

  const TfliteModel& model_;
  std::vector<Tensor> tensors_;
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
