#include "landmark/tflite_model.hpp"

#include <fmt/format.h>

#include <bit>
#include <cstring>
#include <optional>

#include "facet/error.hpp"

namespace facet::landmark {
namespace {

static_assert(std::endian::native == std::endian::little, "FlatBuffers are read in place");

constexpr std::size_t max_rank = 6;
constexpr std::size_t max_operands =
    64;                              ///< of one operator: bounds the memory that shared vectors could claim
constexpr int max_extent = 1 << 24;  ///< of one dimension
constexpr int max_stride = 64;

// Field numbers and codes of TensorFlow's schema, version 3.
namespace model_field {
constexpr int operator_codes = 1;
constexpr int subgraphs = 2;
constexpr int buffers = 4;
}  // namespace model_field
namespace code_field {
constexpr int old_builtin = 0;
constexpr int custom_name = 1;
constexpr int builtin = 3;
}  // namespace code_field
namespace graph_field {
constexpr int tensors = 0;
constexpr int inputs = 1;
constexpr int outputs = 2;
constexpr int operators = 3;
}  // namespace graph_field
namespace tensor_field {
constexpr int shape = 0;
constexpr int type = 1;
constexpr int buffer = 2;
constexpr int name = 3;
}  // namespace tensor_field
namespace operator_field {
constexpr int code_index = 0;
constexpr int inputs = 1;
constexpr int outputs = 2;
constexpr int options = 4;
constexpr int custom_options = 5;
}  // namespace operator_field

std::optional<OperatorKind> kind_of(int builtin) {
  switch (builtin) {
    case 0:
      return OperatorKind::Add;
    case 2:
      return OperatorKind::Concatenation;
    case 3:
      return OperatorKind::Conv2d;
    case 4:
      return OperatorKind::DepthwiseConv2d;
    case 6:
      return OperatorKind::Dequantize;
    case 17:
      return OperatorKind::MaxPool2d;
    case 18:
      return OperatorKind::Mul;
    case 19:
      return OperatorKind::Relu;
    case 22:
      return OperatorKind::Reshape;
    case 32:
      return OperatorKind::Custom;
    case 34:
      return OperatorKind::Pad;
    case 45:
      return OperatorKind::StridedSlice;
    case 54:
      return OperatorKind::Prelu;
    default:
      return std::nullopt;
  }
}

TensorType type_of(int type) {
  switch (type) {
    case 0:
      return TensorType::Float32;
    case 1:
      return TensorType::Float16;
    case 2:
      return TensorType::Int32;
    default:
      return TensorType::Other;
  }
}

std::size_t element_size(TensorType type) {
  return type == TensorType::Float16 ? 2 : 4;
}

/// The bytes of a FlatBuffer; nothing is read outside them.
class Buffer {
 public:
  Buffer(std::span<const std::uint8_t> bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", name_, what));
  }
  std::size_t size() const { return bytes_.size(); }

  template <typename T>
  T read(std::size_t at) const {
    check(at, sizeof(T));
    T value;
    std::memcpy(&value, bytes_.data() + at, sizeof(T));
    return value;
  }
  std::span<const std::uint8_t> bytes(std::size_t at, std::size_t count) const {
    check(at, count);
    return bytes_.subspan(at, count);
  }
  /// Where the offset stored at `at` points.
  std::size_t follow(std::size_t at) const {
    const std::size_t target = at + read<std::uint32_t>(at);
    check(target, sizeof(std::uint32_t));
    return target;
  }

 private:
  void check(std::size_t at, std::size_t count) const {
    if (at > bytes_.size() || count > bytes_.size() - at) {
      fail(fmt::format("damaged: {} bytes at {} of {}", count, at, bytes_.size()));
    }
  }

  std::span<const std::uint8_t> bytes_;
  const std::string& name_;
};

/// A vector of a FlatBuffer: element count and where the elements start.
struct Vector {
  std::size_t count = 0;
  std::size_t first = 0;
};

class Table {
 public:
  Table(const Buffer& buffer, std::size_t at) : buffer_(&buffer), at_(at) {
    const auto back = static_cast<std::int64_t>(buffer.read<std::int32_t>(at));
    const std::int64_t fields = static_cast<std::int64_t>(at) - back;
    if (fields < 0) {
      buffer.fail(fmt::format("damaged: the table at {} has its fields before the file", at));
    }
    fields_ = static_cast<std::size_t>(fields);
    fields_size_ = buffer.read<std::uint16_t>(fields_);
  }

  template <typename T>
  T scalar(int field, T missing) const {
    const std::size_t at = find(field);
    return at == 0 ? missing : buffer_->read<T>(at);
  }
  std::optional<Table> table(int field) const {
    const std::size_t at = find(field);
    return at == 0 ? std::nullopt : std::optional<Table>(Table(*buffer_, buffer_->follow(at)));
  }
  Vector vector(int field, std::size_t element_bytes) const {
    const std::size_t at = find(field);
    if (at == 0) {
      return {};
    }
    const std::size_t head = buffer_->follow(at);
    const Vector vector{buffer_->read<std::uint32_t>(head), head + sizeof(std::uint32_t)};
    buffer_->bytes(vector.first, vector.count * element_bytes);
    return vector;
  }
  std::span<const std::uint8_t> bytes(int field) const {
    const Vector content = vector(field, 1);
    return content.count == 0 ? std::span<const std::uint8_t>()
                              : buffer_->bytes(content.first, content.count);
  }
  std::string_view text(int field) const {
    const auto content = bytes(field);
    return {reinterpret_cast<const char*>(content.data()), content.size()};
  }
  std::vector<int> ints(int field, std::size_t limit, const char* what) const {
    const Vector content = vector(field, sizeof(std::int32_t));
    if (content.count > limit) {
      buffer_->fail(fmt::format("{} {}, at most {} are understood", content.count, what, limit));
    }
    std::vector<int> values(content.count);
    for (std::size_t i = 0; i < content.count; ++i) {
      values[i] = buffer_->read<std::int32_t>(content.first + i * sizeof(std::int32_t));
    }
    return values;
  }
  Table element(const Vector& tables, std::size_t index) const {
    return {*buffer_, buffer_->follow(tables.first + index * sizeof(std::uint32_t))};
  }

 private:
  /// Where a field's value lies, 0 where the table leaves it out.
  std::size_t find(int field) const {
    const std::size_t slot = 4 + 2 * static_cast<std::size_t>(field);
    if (slot + 2 > fields_size_) {
      return 0;
    }
    const std::size_t offset = buffer_->read<std::uint16_t>(fields_ + slot);
    return offset == 0 ? 0 : at_ + offset;
  }

  const Buffer* buffer_;
  std::size_t at_;
  std::size_t fields_ = 0;
  std::size_t fields_size_ = 0;
};

int checked(const Buffer& buffer, int value, int low, int high, const char* what) {
  if (value < low || value > high) {
    buffer.fail(fmt::format("{} is {}, expected {} to {}", what, value, low, high));
  }
  return value;
}

PaddingMode padding_of(const Buffer& buffer, int code) {
  return checked(buffer, code, 0, 1, "a padding mode") == 0 ? PaddingMode::Same : PaddingMode::Valid;
}

void read_options(const Buffer& buffer, const std::optional<Table>& options, TfliteOperator& op) {
  const auto integer = [&](int field, int missing) {
    return options ? options->scalar<std::int32_t>(field, missing) : missing;
  };
  const auto byte = [&](int field) -> int { return options ? options->scalar<std::int8_t>(field, 0) : 0; };
  int activation = 0;
  switch (op.kind) {
    case OperatorKind::Conv2d:
      op.padding = padding_of(buffer, byte(0));
      op.stride_columns = checked(buffer, integer(1, 1), 1, max_stride, "a stride");
      op.stride_rows = checked(buffer, integer(2, 1), 1, max_stride, "a stride");
      activation = byte(3);
      checked(buffer, integer(4, 1), 1, 1, "a dilation");
      checked(buffer, integer(5, 1), 1, 1, "a dilation");
      break;
    case OperatorKind::DepthwiseConv2d:
      op.padding = padding_of(buffer, byte(0));
      op.stride_columns = checked(buffer, integer(1, 1), 1, max_stride, "a stride");
      op.stride_rows = checked(buffer, integer(2, 1), 1, max_stride, "a stride");
      checked(buffer, integer(3, 1), 1, 1, "a depth multiplier");
      activation = byte(4);
      checked(buffer, integer(5, 1), 1, 1, "a dilation");
      checked(buffer, integer(6, 1), 1, 1, "a dilation");
      break;
    case OperatorKind::MaxPool2d:
      op.padding = padding_of(buffer, byte(0));
      op.stride_columns = checked(buffer, integer(1, 1), 1, max_stride, "a stride");
      op.stride_rows = checked(buffer, integer(2, 1), 1, max_stride, "a stride");
      op.filter_columns = checked(buffer, integer(3, 1), 1, max_stride, "a filter size");
      op.filter_rows = checked(buffer, integer(4, 1), 1, max_stride, "a filter size");
      activation = byte(5);
      break;
    case OperatorKind::Concatenation:
      op.axis = checked(buffer, integer(0, 0), 0, static_cast<int>(max_rank) - 1, "an axis");
      activation = byte(1);
      break;
    case OperatorKind::Add:
    case OperatorKind::Mul:
      activation = byte(0);
      break;
    case OperatorKind::Dequantize:
    case OperatorKind::Pad:
    case OperatorKind::Prelu:
    case OperatorKind::Relu:
    case OperatorKind::Reshape:
    case OperatorKind::StridedSlice:
    case OperatorKind::Custom:
      break;
  }
  checked(buffer, activation, 0, 0, "a fused activation");
}

TfliteTensor read_tensor(const Buffer& buffer, const Table& tensor, const Table& model,
                         const Vector& buffers) {
  TfliteTensor result;
  result.name = tensor.text(tensor_field::name);
  result.type = type_of(tensor.scalar<std::int8_t>(tensor_field::type, 0));
  result.shape = tensor.ints(tensor_field::shape, max_rank, "dimensions");
  for (const int extent : result.shape) {
    checked(buffer, extent, 1, max_extent, "a tensor's extent");
  }
  const auto index = tensor.scalar<std::uint32_t>(tensor_field::buffer, 0);
  if (index >= buffers.count) {
    buffer.fail(fmt::format("a tensor names buffer {} of {}", index, buffers.count));
  }
  result.data = model.element(buffers, index).bytes(0);
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
    buffer.fail(fmt::format("a constant tensor has {} bytes, which is not its shape", result.data.size()));
  }
  return result;
}

TfliteOperator read_operator(const Buffer& buffer, const Table& table, const Table& model,
                             const Vector& codes) {
  const auto index = table.scalar<std::uint32_t>(operator_field::code_index, 0);
  if (index >= codes.count) {
    buffer.fail(fmt::format("an operator names code {} of {}", index, codes.count));
  }
  const Table code = model.element(codes, index);
  // Files older than schema 3a hold the code only in the byte, newer ones in both.
  const int builtin = std::max<int>(code.scalar<std::int8_t>(code_field::old_builtin, 0),
                                    code.scalar<std::int32_t>(code_field::builtin, 0));
  const auto kind = kind_of(builtin);
  if (!kind) {
    buffer.fail(fmt::format("operator code {} is not supported", builtin));
  }
  TfliteOperator op;
  op.kind = *kind;
  op.inputs = table.ints(operator_field::inputs, max_operands, "operands");
  op.outputs = table.ints(operator_field::outputs, max_operands, "results");
  if (op.kind == OperatorKind::Custom) {
    op.custom_name = code.text(code_field::custom_name);
    op.custom_options = table.bytes(operator_field::custom_options);
  }
  read_options(buffer, table.table(operator_field::options), op);
  return op;
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
  const Buffer buffer(file, name);
  if (file.size() < 8 || std::memcmp(file.data() + 4, "TFL3", 4) != 0) {
    buffer.fail("not a TensorFlow Lite model (no TFL3 at byte 4)");
  }
  const Table model(buffer, buffer.follow(0));
  const Vector codes = model.vector(model_field::operator_codes, sizeof(std::uint32_t));
  const Vector graphs = model.vector(model_field::subgraphs, sizeof(std::uint32_t));
  const Vector buffers = model.vector(model_field::buffers, sizeof(std::uint32_t));
  if (graphs.count == 0) {
    buffer.fail("holds no graph");
  }
  const Table graph = model.element(graphs, 0);

  TfliteModel result;
  const Vector tensors = graph.vector(graph_field::tensors, sizeof(std::uint32_t));
  result.tensors.reserve(tensors.count);
  for (std::size_t i = 0; i < tensors.count; ++i) {
    result.tensors.push_back(read_tensor(buffer, graph.element(tensors, i), model, buffers));
  }
  const Vector operators = graph.vector(graph_field::operators, sizeof(std::uint32_t));
  result.operators.reserve(operators.count);
  for (std::size_t i = 0; i < operators.count; ++i) {
    result.operators.push_back(read_operator(buffer, graph.element(operators, i), model, codes));
  }
  result.inputs = graph.ints(graph_field::inputs, max_operands, "inputs");
  result.outputs = graph.ints(graph_field::outputs, max_operands, "outputs");

  const int last = static_cast<int>(result.tensors.size()) - 1;
  const auto check_all = [&](const std::vector<int>& indices, int low) {
    for (const int index : indices) {
      checked(buffer, index, low, last, "a tensor index");
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
