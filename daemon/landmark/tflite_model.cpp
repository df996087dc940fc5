#include "landmark/tflite_model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "facet/assert.hpp"
#include "facet/error.hpp"
#include "tflite_generated.h"

namespace facet::landmark {
namespace {

constexpr int max_depth = 8;           ///< of tables in each other; the format's go 5 deep
constexpr int max_tables = 1'000'000;  ///< bounds the time where vectors share their tables
constexpr std::size_t max_rank = 6;
constexpr std::size_t max_operands =
    64;                              ///< of one operator: bounds the memory that shared vectors could claim
constexpr int max_extent = 1 << 24;  ///< of one dimension
constexpr std::int64_t max_elements = std::int64_t{1} << 31;  ///< of a tensor
constexpr int max_stride = 64;

bool is_known(OperatorKind kind) {
  switch (kind) {
    case OperatorKind::Add:
    case OperatorKind::Concatenation:
    case OperatorKind::Conv2d:
    case OperatorKind::DepthwiseConv2d:
    case OperatorKind::Dequantize:
    case OperatorKind::MaxPool2d:
    case OperatorKind::Mul:
    case OperatorKind::Relu:
    case OperatorKind::Reshape:
    case OperatorKind::Custom:
    case OperatorKind::Pad:
    case OperatorKind::StridedSlice:
    case OperatorKind::Prelu:
      return true;
  }
  return false;
}

TensorType type_of(int code) {
  return code >= 0 && code < static_cast<int>(TensorType::Other) ? static_cast<TensorType>(code)
                                                                 : TensorType::Other;
}

std::size_t element_size(TensorType type) {
  return type == TensorType::Float16 ? 2 : 4;
}

std::span<const std::uint8_t> bytes_of(const flatbuffers::Vector<std::uint8_t>* bytes) {
  return bytes == nullptr ? std::span<const std::uint8_t>() : std::span(bytes->data(), bytes->size());
}

std::string_view text_of(const flatbuffers::String* text) {
  return text == nullptr ? std::string_view() : std::string_view(text->data(), text->size());
}

template <typename T>
std::size_t count_of(const flatbuffers::Vector<T>* vector) {
  return vector == nullptr ? 0 : vector->size();
}

/// What a verified file says beyond its structure, checked.
class Reader {
 public:
  Reader(const tflite::Model& model, const std::string& name) : model_(model), name_(name) {}

  TfliteModel read() const;

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", name_, what));
  }
  int checked(int value, int low, int high, const char* what) const {
    if (value < low || value > high) {
      fail(fmt::format("{} is {}, expected {} to {}", what, value, low, high));
    }
    return value;
  }
  std::vector<int> ints(const flatbuffers::Vector<std::int32_t>* values, std::size_t limit,
                        const char* what) const {
    if (count_of(values) > limit) {
      fail(fmt::format("{} {}, at most {} are understood", values->size(), what, limit));
    }
    return values == nullptr ? std::vector<int>() : std::vector<int>(values->begin(), values->end());
  }

  template <typename Options>
  const Options& options_of(const tflite::Operator& op) const {
    const Options* options = op.options_as<Options>();
    if (options == nullptr) {
      fail("an operator lacks the options of its kind");
    }
    return *options;
  }
  /// Padding and strides, which the options of three operators have.
  template <typename Options>
  void read_window(const Options& options, TfliteOperator& op) const {
    op.padding = static_cast<PaddingMode>(checked(options.padding(), 0, 1, "a padding mode"));
    op.stride_columns = checked(options.stride_w(), 1, max_stride, "a stride");
    op.stride_rows = checked(options.stride_h(), 1, max_stride, "a stride");
  }
  template <typename Options>
  void check_undilated(const Options& options) const {
    checked(options.dilation_w(), 1, 1, "a dilation");
    checked(options.dilation_h(), 1, 1, "a dilation");
  }
  void read_options(const tflite::Operator& from, TfliteOperator& op) const;
  TfliteTensor read_tensor(const tflite::Tensor& tensor) const;
  TfliteOperator read_operator(const tflite::Operator& from) const;

  const tflite::Model& model_;
  const std::string& name_;
};

void Reader::read_options(const tflite::Operator& from, TfliteOperator& op) const {
  int activation = 0;
  switch (op.kind) {
    case OperatorKind::Conv2d: {
      const auto& options = options_of<tflite::Conv2DOptions>(from);
      read_window(options, op);
      check_undilated(options);
      activation = options.activation();
      break;
    }
    case OperatorKind::DepthwiseConv2d: {
      const auto& options = options_of<tflite::DepthwiseConv2DOptions>(from);
      read_window(options, op);
      check_undilated(options);
      checked(options.depth_multiplier(), 0, 1, "a depth multiplier");  // 0: what the weights' shape says
      activation = options.activation();
      break;
    }
    case OperatorKind::MaxPool2d: {
      const auto& options = options_of<tflite::Pool2DOptions>(from);
      read_window(options, op);
      op.filter_columns = checked(options.filter_w(), 1, max_stride, "a filter size");
      op.filter_rows = checked(options.filter_h(), 1, max_stride, "a filter size");
      activation = options.activation();
      break;
    }
    case OperatorKind::Concatenation: {
      const auto& options = options_of<tflite::ConcatenationOptions>(from);
      op.axis = checked(options.axis(), 0, static_cast<int>(max_rank) - 1, "an axis");
      activation = options.activation();
      break;
    }
    case OperatorKind::Add:
      activation = options_of<tflite::AddOptions>(from).activation();
      break;
    case OperatorKind::Mul:
      activation = options_of<tflite::MulOptions>(from).activation();
      break;
    case OperatorKind::Custom:
    case OperatorKind::Dequantize:
    case OperatorKind::Pad:
    case OperatorKind::Prelu:
    case OperatorKind::Relu:
    case OperatorKind::Reshape:
    case OperatorKind::StridedSlice:
      break;
  }
  checked(activation, 0, 0, "a fused activation");
}

TfliteTensor Reader::read_tensor(const tflite::Tensor& tensor) const {
  TfliteTensor result;
  result.name = text_of(tensor.name());
  result.type = type_of(tensor.type());
  result.shape = ints(tensor.shape(), max_rank, "dimensions");
  std::int64_t shaped = 1;
  for (const int extent : result.shape) {
    shaped *= checked(extent, 1, max_extent, "a tensor's extent");
    if (shaped > max_elements) {
      fail(fmt::format("a tensor is too large: more than {} elements", max_elements));
    }
  }
  if (tensor.buffer() >= count_of(model_.buffers())) {
    fail(fmt::format("a tensor names buffer {} of {}", tensor.buffer(), count_of(model_.buffers())));
  }
  result.data = bytes_of(model_.buffers()->Get(tensor.buffer())->data());
  if (result.data.empty() || result.type == TensorType::Other) {
    return result;
  }
  std::size_t elements = result.data.size() / element_size(result.type);
  for (const int extent : result.shape) {
    if (elements % static_cast<std::size_t>(extent) != 0) {
      elements = 0;
      break;
    }
    elements /= static_cast<std::size_t>(extent);
  }
  if (elements != 1 || result.data.size() % element_size(result.type) != 0) {
    fail(fmt::format("a constant tensor has {} bytes, which is not its shape", result.data.size()));
  }
  return result;
}

TfliteOperator Reader::read_operator(const tflite::Operator& from) const {
  if (from.code_index() >= count_of(model_.codes())) {
    fail(fmt::format("an operator names code {} of {}", from.code_index(), count_of(model_.codes())));
  }
  const tflite::OperatorCode& code = *model_.codes()->Get(from.code_index());
  const int number = std::max<int>(code.old_code(), code.code());
  TfliteOperator op;
  op.kind = static_cast<OperatorKind>(number);
  if (!is_known(op.kind)) {
    fail(fmt::format("operator code {} is not supported", number));
  }
  op.inputs = ints(from.inputs(), max_operands, "operands");
  op.outputs = ints(from.outputs(), max_operands, "results");
  if (op.kind == OperatorKind::Custom) {
    op.custom_name = text_of(code.custom_name());
    op.custom_options = bytes_of(from.custom_options());
  }
  read_options(from, op);
  return op;
}

TfliteModel Reader::read() const {
  if (count_of(model_.graphs()) == 0) {
    fail("holds no graph");
  }
  const tflite::Graph& graph = *model_.graphs()->Get(0);
  TfliteModel result;
  result.tensors.reserve(count_of(graph.tensors()));
  for (flatbuffers::uoffset_t i = 0; i < count_of(graph.tensors()); ++i) {
    result.tensors.push_back(read_tensor(*graph.tensors()->Get(i)));
  }
  result.operators.reserve(count_of(graph.operators()));
  for (flatbuffers::uoffset_t i = 0; i < count_of(graph.operators()); ++i) {
    result.operators.push_back(read_operator(*graph.operators()->Get(i)));
  }
  result.inputs = ints(graph.inputs(), max_operands, "inputs");
  result.outputs = ints(graph.outputs(), max_operands, "outputs");

  const int last = static_cast<int>(result.tensors.size()) - 1;
  const auto check_all = [&](const std::vector<int>& indices, int low) {
    for (const int index : indices) {
      checked(index, low, last, "a tensor index");
    }
  };
  check_all(result.inputs, 0);
  check_all(result.outputs, 0);
  for (const TfliteOperator& op : result.operators) {
    check_all(op.inputs, -1);
    check_all(op.outputs, 0);
  }
  return result;
}

}  // namespace

std::size_t TfliteTensor::element_count() const {
  std::size_t count = 1;
  for (const int extent : shape) {
    count *= static_cast<std::size_t>(extent);
  }
  return count;
}

std::vector<float> TfliteModel::constant_floats(int tensor) const {
  const TfliteTensor& constant = tensors.at(static_cast<std::size_t>(tensor));
  if (constant.data.empty() ||
      (constant.type != TensorType::Float32 && constant.type != TensorType::Float16)) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("tensor {} ({}) is not a constant of floats", tensor, constant.name));
  }
  const std::size_t bytes = element_size(constant.type);
  std::vector<float> values(constant.data.size() / bytes);
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (constant.type == TensorType::Float32) {
      std::memcpy(&values[i], constant.data.data() + i * bytes, bytes);
    } else {
      std::uint16_t half = 0;
      std::memcpy(&half, constant.data.data() + i * bytes, bytes);
      values[i] = float_from_half(half);
    }
  }
  return values;
}

std::vector<int> TfliteModel::constant_ints(int tensor) const {
  const TfliteTensor& constant = tensors.at(static_cast<std::size_t>(tensor));
  if (constant.data.empty() || constant.type != TensorType::Int32) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("tensor {} ({}) is not a constant of integers", tensor, constant.name));
  }
  std::vector<int> values(constant.data.size() / sizeof(std::int32_t));
  std::memcpy(values.data(), constant.data.data(), values.size() * sizeof(std::int32_t));
  return values;
}

TfliteModel parse_tflite(std::span<const std::uint8_t> file, const std::string& name) {
  const auto address = reinterpret_cast<std::uintptr_t>(file.data());
  FACET_ASSERT(address % alignof(std::uint32_t) == 0, address);
  const auto refuse = [&](const char* what) {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", name, what));
  };
  if (file.size() < 8 || !tflite::ModelBufferHasIdentifier(file.data())) {
    refuse("not a TensorFlow Lite model (no TFL3 at byte 4)");
  }
  flatbuffers::Verifier verifier(file.data(), file.size(), max_depth, max_tables);
  if (!tflite::VerifyModelBuffer(verifier)) {
    refuse("damaged: its tables do not lie within it");
  }
  return Reader(*tflite::GetModel(file.data()), name).read();
}

float float_from_half(std::uint16_t half) {
  constexpr int fraction_bits = 10;
  const std::uint32_t sign = static_cast<std::uint32_t>(half & 0x8000U) << 16U;
  const std::uint32_t exponent = (half >> fraction_bits) & 0x1FU;
  const std::uint32_t fraction = half & 0x3FFU;
  if (exponent == 0) {
    const float magnitude = static_cast<float>(fraction) * 0x1p-24F;
    return sign != 0 ? -magnitude : magnitude;
  }
  const std::uint32_t wide_exponent = exponent == 0x1FU ? 0xFFU : exponent + 127U - 15U;
  return std::bit_cast<float>(sign | (wide_exponent << 23U) | (fraction << 13U));
}

}  // namespace facet::landmark
