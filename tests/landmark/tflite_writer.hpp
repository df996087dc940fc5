#pragma once

#include <flatbuffers/flatbuffers.h>

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace facet::test {

/// Writes TensorFlow Lite files (schema version 3) with the format's field numbers themselves, to test a
/// reader that has a schema.
class TfliteWriter {
 public:
  enum Builtin : std::int8_t {
    Add = 0,
    Concatenation = 2,
    Conv2d = 3,
    DepthwiseConv2d = 4,
    Dequantize = 6,
    MaxPool2d = 17,
    Mul = 18,
    Relu = 19,
    Reshape = 22,
    Softmax = 25,
    Custom = 32,
    Pad = 34,
    Prelu = 54
  };
  enum Type : std::int8_t { Float32 = 0, Float16 = 1, Int32 = 2 };

  /// One field of an operator's options: a byte or a 32-bit integer.
  struct Option {
    int field = 0;
    int value = 0;
    bool is_byte = false;
  };

  int tensor(const std::vector<int>& shape, Type type = Float32, const std::vector<std::uint8_t>& data = {}) {
    tensors_.push_back({shape, type, data});
    return static_cast<int>(tensors_.size()) - 1;
  }
  int constant(const std::vector<int>& shape, const std::vector<float>& values) {
    return tensor(shape, Float32, bytes_of(values));
  }
  int constant(const std::vector<int>& shape, const std::vector<std::int32_t>& values) {
    return tensor(shape, Int32, bytes_of(values));
  }
  void add(Builtin code, const std::vector<int>& inputs, const std::vector<int>& outputs,
           const std::vector<Option>& options = {}, const std::string& custom_name = {}) {
    operators_.push_back({code, inputs, outputs, options, custom_name});
  }

  std::vector<std::uint8_t> finish(const std::vector<int>& inputs, const std::vector<int>& outputs) const {
    flatbuffers::FlatBufferBuilder b;
    using Offset = flatbuffers::Offset<flatbuffers::Table>;
    const auto table = [&](auto fill) {
      const auto start = b.StartTable();
      fill();
      return Offset(b.EndTable(start));
    };
    std::vector<Offset> buffers{table([] {})};
    std::vector<Offset> tensors;
    for (const Tensor& tensor : tensors_) {
      std::uint32_t buffer = 0;
      if (!tensor.data.empty()) {
        b.ForceVectorAlignment(tensor.data.size(), 1, 16);
        const auto data = b.CreateVector(tensor.data);
        buffer = static_cast<std::uint32_t>(buffers.size());
        buffers.push_back(table([&] { b.AddOffset(slot(0), data); }));
      }
      const auto shape = b.CreateVector(tensor.shape);
      const auto name = b.CreateString("tensor");
      tensors.push_back(table([&] {
        b.AddOffset(slot(0), shape);
        b.AddElement<std::int8_t>(slot(1), tensor.type, 0);
        b.AddElement<std::uint32_t>(slot(2), buffer, 0);
        b.AddOffset(slot(3), name);
      }));
    }
    std::vector<Offset> codes;
    std::vector<Offset> operators;
    for (const Operator& op : operators_) {
      const auto custom_name = b.CreateString(op.custom_name);
      codes.push_back(table([&] {
        b.AddElement<std::int8_t>(slot(0), op.code, 0);
        b.AddOffset(slot(1), custom_name);
        b.AddElement<std::int32_t>(slot(3), op.code, 0);
      }));
      const auto ins = b.CreateVector(op.inputs);
      const auto outs = b.CreateVector(op.outputs);
      const auto options = table([&] {
        for (const Option& option : op.options) {
          if (option.is_byte) {
            b.AddElement<std::int8_t>(slot(option.field), static_cast<std::int8_t>(option.value), 0);
          } else {
            b.AddElement<std::int32_t>(slot(option.field), option.value, 0);
          }
        }
      });
      operators.push_back(table([&] {
        b.AddElement<std::uint32_t>(slot(0), static_cast<std::uint32_t>(operators.size()), 0);
        b.AddOffset(slot(1), ins);
        b.AddOffset(slot(2), outs);
        b.AddElement<std::uint8_t>(slot(3), options_type(op.code), 0);
        b.AddOffset(slot(4), options);
      }));
    }
    const auto tensor_vector = b.CreateVector(tensors);
    const auto operator_vector = b.CreateVector(operators);
    const auto input_vector = b.CreateVector(inputs);
    const auto output_vector = b.CreateVector(outputs);
    const std::vector<Offset> graphs{table([&] {
      b.AddOffset(slot(0), tensor_vector);
      b.AddOffset(slot(1), input_vector);
      b.AddOffset(slot(2), output_vector);
      b.AddOffset(slot(3), operator_vector);
    })};
    const auto graph_vector = b.CreateVector(graphs);
    const auto code_vector = b.CreateVector(codes);
    const auto buffer_vector = b.CreateVector(buffers);
    b.Finish(table([&] {
               b.AddElement<std::uint32_t>(slot(0), 3, 0);
               b.AddOffset(slot(1), code_vector);
               b.AddOffset(slot(2), graph_vector);
               b.AddOffset(slot(4), buffer_vector);
             }),
             "TFL3");
    return {b.GetBufferPointer(), b.GetBufferPointer() + b.GetSize()};
  }

 private:
  struct Tensor {
    std::vector<int> shape;
    Type type;
    std::vector<std::uint8_t> data;
  };
  struct Operator {
    Builtin code;
    std::vector<int> inputs;
    std::vector<int> outputs;
    std::vector<Option> options;
    std::string custom_name;
  };

  /// Which of the format's option tables an operator has.
  static std::uint8_t options_type(Builtin code) {
    switch (code) {
      case Conv2d:
        return 1;
      case DepthwiseConv2d:
        return 2;
      case MaxPool2d:
        return 5;
      case Concatenation:
        return 10;
      case Add:
        return 11;
      case Mul:
        return 21;
      default:
        return 0;
    }
  }
  static flatbuffers::voffset_t slot(int field) { return static_cast<flatbuffers::voffset_t>(4 + 2 * field); }
  template <typename T>
  static std::vector<std::uint8_t> bytes_of(const std::vector<T>& values) {
    std::vector<std::uint8_t> bytes(values.size() * sizeof(T));
    std::memcpy(bytes.data(), values.data(), bytes.size());
    return bytes;
  }

  std::vector<Tensor> tensors_;
  std::vector<Operator> operators_;
};

/// Options of the operators as TensorFlow's schema numbers them.
inline std::vector<TfliteWriter::Option> conv_options(bool valid, int stride_columns, int stride_rows,
                                                      int activation = 0) {
  return {{0, valid ? 1 : 0, true}, {1, stride_columns}, {2, stride_rows}, {3, activation, true}};
}
inline std::vector<TfliteWriter::Option> depthwise_options(bool valid, int stride_columns, int stride_rows) {
  return {{0, valid ? 1 : 0, true}, {1, stride_columns}, {2, stride_rows}, {3, 1}};
}
inline std::vector<TfliteWriter::Option> pool_options(bool valid, int stride, int filter) {
  return {{0, valid ? 1 : 0, true}, {1, stride}, {2, stride}, {3, filter}, {4, filter}};
}

}  // namespace facet::test
