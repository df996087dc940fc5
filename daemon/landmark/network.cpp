#include "landmark/network.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <map>
#include <opencv2/dnn.hpp>

#include "facet/error.hpp"
#include "facet/system_error.hpp"

namespace facet::landmark {
namespace {

/// Builds a cv::dnn::Net, which works on [batch][channels][rows][columns], from a graph in TensorFlow's
/// [batch][rows][columns][channels]. Tensors of other ranks keep their layout.
class NetBuilder {
 public:
  NetBuilder(const TfliteModel& model, std::string name, int channels)
      : model_(model), name_(std::move(name)) {
    if (model.inputs.size() != 1 || tensor(model.inputs[0]).shape.size() != 4 ||
        tensor(model.inputs[0]).shape[0] != 1 || tensor(model.inputs[0]).shape[3] != channels) {
      fail(channels == 3 ? "the net must have one RGB image as its input"
                         : fmt::format("the net must have one image of {} channels as its input", channels));
    }
    layer_of_[model.inputs[0]] = 0;
    for (const TfliteOperator& op : model.operators) {
      add(op);
    }
    for (const int output : model.outputs) {
      output_names.push_back(channels_last_name(output));
    }
  }

  cv::dnn::Net net;
  std::vector<cv::String> output_names;

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", name_, what));
  }

  const TfliteTensor& tensor(int index) const { return model_.tensors.at(static_cast<std::size_t>(index)); }

  int operand(const TfliteOperator& op, std::size_t position) const {
    if (position >= op.inputs.size() || op.inputs[position] < 0) {
      fail(fmt::format("an operator lacks its operand {}", position));
    }
    return op.inputs[position];
  }
  int result(const TfliteOperator& op) const {
    if (op.outputs.size() != 1) {
      fail(fmt::format("an operator has {} results", op.outputs.size()));
    }
    return op.outputs[0];
  }

  /// A constant operand as floats; weights are stored as float16 behind a Dequantize.
  std::vector<float> floats(int index) const {
    const auto source = dequantized_.find(index);
    return model_.constant_floats(source == dequantized_.end() ? index : source->second);
  }

  int layer(int index) const {
    const auto found = layer_of_.find(index);
    if (found == layer_of_.end()) {
      fail(fmt::format("tensor {} ({}) is used before it is computed", index, tensor(index).name));
    }
    return found->second;
  }

  /// Adds a layer that reads the given layers.
  int append(const std::string& name, const char* type, cv::dnn::LayerParams& params,
             const std::vector<int>& sources) {
    params.name = name;
    params.type = type;
    const int id = net.addLayer(params.name, params.type, params);
    for (std::size_t i = 0; i < sources.size(); ++i) {
      net.connect(sources[i], 0, id, static_cast<int>(i));
    }
    return id;
  }
  static std::string layer_name(int index) { return fmt::format("t{}", index); }

  void append_result(const TfliteOperator& op, const char* type, cv::dnn::LayerParams& params,
                     const std::vector<int>& tensors) {
    std::vector<int> sources;
    std::transform(tensors.begin(), tensors.end(), std::back_inserter(sources),
                   [&](int t) { return layer(t); });
    const int index = result(op);
    layer_of_[index] = append(layer_name(index), type, params, sources);
  }

  static bool is_image(const std::vector<int>& shape) { return shape.size() == 4 && shape[1] * shape[2] > 1; }

  static cv::dnn::LayerParams permutation(std::array<int, 4> order) {
    cv::dnn::LayerParams params;
    params.set("order", cv::dnn::DictValue::arrayInt(order.data(), 4));
    return params;
  }

  /// The layer that holds a tensor in TensorFlow's layout.
  std::pair<std::string, int> channels_last(int index) {
    if (!is_image(tensor(index).shape)) {
      return {layer_name(index), layer(index)};
    }
    const std::string name = layer_name(index) + "_channels_last";
    const int existing = net.getLayerId(name);
    if (existing >= 0) {
      return {name, existing};
    }
    cv::dnn::LayerParams params = permutation({0, 2, 3, 1});
    return {name, append(name, "Permute", params, {layer(index)})};
  }
  std::string channels_last_name(int index) { return channels_last(index).first; }

  void add(const TfliteOperator& op) {
    switch (op.kind) {
      case OperatorKind::Dequantize:
        dequantized_[result(op)] = operand(op, 0);
        return;
      case OperatorKind::Conv2d:
        return add_convolution(op, false);
      case OperatorKind::DepthwiseConv2d:
        return add_convolution(op, true);
      case OperatorKind::Prelu:
        return add_prelu(op);
      case OperatorKind::MaxPool2d:
        return add_max_pool(op);
      case OperatorKind::Pad:
        return add_pad(op);
      case OperatorKind::Reshape:
        return add_reshape(op);
      case OperatorKind::Concatenation:
        return add_concatenation(op);
      case OperatorKind::Add: {
        cv::dnn::LayerParams params;
        params.set("operation", "sum");
        return append_result(op, "Eltwise", params, {operand(op, 0), operand(op, 1)});
      }
      case OperatorKind::Relu: {
        cv::dnn::LayerParams params;
        return append_result(op, "ReLU", params, {operand(op, 0)});
      }
      case OperatorKind::Mul:
      case OperatorKind::StridedSlice:
      case OperatorKind::Custom:
        fail(fmt::format("holds an operator that this net builder does not know (custom name '{}')",
                         op.custom_name));
    }
  }

  static void set_window(const TfliteOperator& op, int rows, int columns, cv::dnn::LayerParams& params) {
    params.set("kernel_h", rows);
    params.set("kernel_w", columns);
    params.set("stride_h", op.stride_rows);
    params.set("stride_w", op.stride_columns);
    params.set("pad_mode", op.padding == PaddingMode::Same ? "SAME" : "VALID");
  }

  /// Conv2d weights are [outputs][rows][columns][inputs], depthwise ones [1][rows][columns][channels];
  /// OpenCV's [outputs][inputs or 1][rows][columns].
  void add_convolution(const TfliteOperator& op, bool depthwise) {
    const std::vector<int>& shape = tensor(operand(op, 1)).shape;
    const std::vector<int>& source = tensor(operand(op, 0)).shape;
    if (shape.size() != 4 || source.size() != 4 || shape[3] != source[3] || (depthwise && shape[0] != 1)) {
      fail("a convolution's weights do not fit its input");
    }
    const int outputs = depthwise ? shape[3] : shape[0];
    const int inputs = depthwise ? 1 : shape[3];
    const int rows = shape[1];
    const int columns = shape[2];
    const std::vector<float> values = floats(op.inputs[1]);
    const std::vector<float> bias = floats(operand(op, 2));
    if (bias.size() != static_cast<std::size_t>(outputs) ||
        values.size() != tensor(op.inputs[1]).element_count()) {
      fail("a convolution's bias does not fit its weights");
    }
    const std::array<int, 4> sizes{outputs, inputs, rows, columns};
    cv::Mat weights(4, sizes.data(), CV_32F);
    auto* target = weights.ptr<float>();
    for (int o = 0; o < outputs; ++o) {
      for (int i = 0; i < inputs; ++i) {
        for (int k = 0; k < rows * columns; ++k) {
          const int from = depthwise ? k * outputs + o : (o * rows * columns + k) * inputs + i;
          *target++ = values[static_cast<std::size_t>(from)];
        }
      }
    }
    cv::dnn::LayerParams params;
    set_window(op, rows, columns, params);
    params.set("num_output", outputs);
    params.set("group", depthwise ? outputs : 1);
    params.set("bias_term", true);
    params.blobs = {weights, cv::Mat(bias, true)};
    append_result(op, "Convolution", params, {op.inputs[0]});
  }

  void add_prelu(const TfliteOperator& op) {
    const std::vector<float> slopes = floats(operand(op, 1));
    const std::vector<int>& source = tensor(operand(op, 0)).shape;
    if (source.size() != 4 || slopes.size() != static_cast<std::size_t>(source[3])) {
      fail("a PReLU must have one slope for each channel");
    }
    cv::dnn::LayerParams params;
    params.blobs = {cv::Mat(slopes, true)};
    append_result(op, "PReLU", params, {op.inputs[0]});
  }

  void add_max_pool(const TfliteOperator& op) {
    cv::dnn::LayerParams params;
    set_window(op, op.filter_rows, op.filter_columns, params);
    params.set("pool", "max");
    params.set("ceil_mode", false);
    append_result(op, "Pooling", params, {operand(op, 0)});
  }

  void add_pad(const TfliteOperator& op) {
    const std::vector<int> widths = model_.constant_ints(operand(op, 1));
    if (widths.size() != 8 || std::any_of(widths.begin(), widths.end(), [](int w) { return w < 0; })) {
      fail("a padding must give two widths for each of four dimensions");
    }
    const std::array<int, 8> planar{widths[0], widths[1], widths[6], widths[7],
                                    widths[2], widths[3], widths[4], widths[5]};
    cv::dnn::LayerParams params;
    params.set("paddings", cv::dnn::DictValue::arrayInt(planar.data(), 8));
    append_result(op, "Padding", params, {operand(op, 0)});
  }

  /// Reshape keeps the order of the elements in TensorFlow's layout.
  void add_reshape(const TfliteOperator& op) {
    const int index = result(op);
    const std::vector<int>& shape = tensor(index).shape;
    if (is_image(shape) || shape.empty()) {
      fail("reshaping into an image is not supported");
    }
    std::vector<int> dims = shape;
    if (dims.size() == 4) {
      std::swap(dims[1], dims[3]);
    }
    cv::dnn::LayerParams params;
    params.set("dim", cv::dnn::DictValue::arrayInt(dims.data(), static_cast<int>(dims.size())));
    const int source = channels_last(operand(op, 0)).second;
    layer_of_[index] = append(layer_name(index), "Reshape", params, {source});
  }

  void add_concatenation(const TfliteOperator& op) {
    if (tensor(result(op)).shape.size() == 4) {
      fail("concatenating images is not supported");
    }
    cv::dnn::LayerParams params;
    params.set("axis", op.axis);
    append_result(op, "Concat", params, op.inputs);
  }

  const TfliteModel& model_;
  std::string name_;
  std::map<int, int> layer_of_;     ///< tensor -> layer that computes it
  std::map<int, int> dequantized_;  ///< tensor -> the float16 constant it widens
};

}  // namespace

struct Network::Impl {
  cv::dnn::Net net;
  std::vector<cv::String> output_names;
  std::vector<cv::Mat> outputs;
  cv::Mat input;
};

TfliteModel part_of(const TfliteModel& model, int input, const std::vector<int>& outputs,
                    const std::string& name) {
  TfliteModel part;
  part.tensors = model.tensors;
  part.inputs = {input};
  part.outputs = outputs;
  std::vector<char> needed(model.tensors.size(), 0);
  const auto mark = [&](int tensor) {
    if (tensor < 0 || static_cast<std::size_t>(tensor) >= needed.size()) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("{}: it has no tensor {}", name, tensor));
    }
    needed[static_cast<std::size_t>(tensor)] = 1;
  };
  mark(input);
  std::for_each(outputs.begin(), outputs.end(), mark);
  needed[static_cast<std::size_t>(input)] = 0;
  for (auto op = model.operators.rbegin(); op != model.operators.rend(); ++op) {
    const bool used = std::any_of(op->outputs.begin(), op->outputs.end(), [&](int tensor) {
      return tensor != input && needed.at(static_cast<std::size_t>(tensor)) != 0;
    });
    if (used) {
      for (const int tensor : op->inputs) {
        if (tensor >= 0) {
          mark(tensor);
        }
      }
      part.operators.push_back(*op);
    }
  }
  std::reverse(part.operators.begin(), part.operators.end());
  return part;
}

Network::Network(const TfliteModel& model, const std::string& name, int channels)
    : impl_(std::make_unique<Impl>()) {
  try {
    NetBuilder builder(model, name, channels);
    impl_->net = builder.net;
    impl_->output_names = builder.output_names;
    impl_->net.setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
    impl_->net.setPreferableTarget(cv::dnn::DNN_TARGET_CPU);
    const std::vector<int>& shape = model.tensors[static_cast<std::size_t>(model.inputs[0])].shape;
    const std::array<int, 4> sizes{1, channels, shape[1], shape[2]};
    impl_->input = cv::Mat(4, sizes.data(), CV_32F, cv::Scalar(0));
    forward();
    for (std::size_t i = 0; i < impl_->outputs.size(); ++i) {
      const TfliteTensor& expected = model.tensors[static_cast<std::size_t>(model.outputs[i])];
      if (impl_->outputs[i].total() != expected.element_count() || !impl_->outputs[i].isContinuous()) {
        throw Error(ErrorKind::UnreadableInput,
                    fmt::format("{}: output {} has {} values, its shape says {}", name, i,
                                impl_->outputs[i].total(), expected.element_count()));
      }
    }
  } catch (const cv::Exception& error) {
    throw Error(kind_of_errno(error.code == cv::Error::StsNoMem ? ENOMEM : EINVAL),
                fmt::format("{}: OpenCV can't run this net: {}", name, error.what()));
  }
}
Network::~Network() = default;
Network::Network(Network&&) noexcept = default;
Network& Network::operator=(Network&&) noexcept = default;

int Network::input_rows() const {
  return impl_->input.size[2];
}
int Network::input_columns() const {
  return impl_->input.size[3];
}
std::span<float> Network::input() {
  return {impl_->input.ptr<float>(), impl_->input.total()};
}
void Network::forward() {
  impl_->net.setInput(impl_->input);
  impl_->net.forward(impl_->outputs, impl_->output_names);
}
std::span<const float> Network::output(std::size_t index) const {
  const cv::Mat& output = impl_->outputs.at(index);
  return {output.ptr<float>(), output.total()};
}
std::size_t Network::output_count() const {
  return impl_->outputs.size();
}

}  // namespace facet::landmark
