#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace facet::landmark {

// What is understood of the format, by the format's codes.
enum class TensorType { Float32 = 0, Float16 = 1, Int32 = 2, Other };
enum class OperatorKind {
  Add = 0,
  Concatenation = 2,
  Conv2d = 3,
  DepthwiseConv2d = 4,
  Dequantize = 6,
  MaxPool2d = 17,
  Mul = 18,
  Relu = 19,
  Reshape = 22,
  Custom = 32,
  Pad = 34,
  StridedSlice = 45,
  Prelu = 54
};
enum class PaddingMode { Same = 0, Valid = 1 };

/// One tensor of the graph; four-dimensional ones are [batch][rows][columns][channels].
struct TfliteTensor {
  std::string_view name;  ///< for messages; borrowed from the file
  TensorType type = TensorType::Other;
  std::vector<int> shape;
  std::span<const std::uint8_t> data;  ///< of a constant, borrowed from the file; empty: computed

  /// Product of the shape; 1 for a scalar.
  std::size_t element_count() const;
};

/// One operation. Fields that its kind does not have keep their defaults.
struct TfliteOperator {
  OperatorKind kind = OperatorKind::Custom;
  std::vector<int> inputs;   ///< tensor indices; -1: an optional input that is absent
  std::vector<int> outputs;  ///< tensor indices
  PaddingMode padding = PaddingMode::Same;
  int stride_rows = 1;
  int stride_columns = 1;
  int filter_rows = 1;
  int filter_columns = 1;
  int axis = 0;
  std::string_view custom_name;                  ///< kind Custom; borrowed from the file
  std::span<const std::uint8_t> custom_options;  ///< kind Custom; borrowed from the file
};

/// The main graph of a TensorFlow Lite file: operators in the order of execution.
struct TfliteModel {
  std::vector<TfliteTensor> tensors;
  std::vector<TfliteOperator> operators;
  std::vector<int> inputs;   ///< tensor indices
  std::vector<int> outputs;  ///< tensor indices

  /// The values of a constant tensor, float16 widened. Throws Error(UnreadableInput) where the tensor is not
  /// a constant of floats.
  std::vector<float> constant_floats(int tensor) const;
  /// The values of a constant int32 tensor; throws likewise.
  std::vector<int> constant_ints(int tensor) const;
};

/// Reads the first subgraph of a TensorFlow Lite file (FlatBuffers, identifier TFL3; tflite.fbs). Its
/// structure is verified before anything is followed, so that any bytes give either a consistent model or an
/// error; memory stays linear in the size of the file. Understood are the operators of OperatorKind without
/// fused activation or dilation. The model borrows `file`, which must outlive it and begin at a multiple of 4
/// bytes. Throws Error(UnreadableInput) that starts with `name`.
TfliteModel parse_tflite(std::span<const std::uint8_t> file, const std::string& name);

/// IEEE 754 binary16 to binary32, exact; subnormals, infinities and NaN included.
float float_from_half(std::uint16_t half);

}  // namespace facet::landmark
