#include "landmark/tflite_model.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "facet/error.hpp"
#include "tflite_writer.hpp"

namespace facet::landmark {
namespace {

using test::TfliteWriter;
using testing::ElementsAre;
using testing::HasSubstr;

/// A convolution with float16 weights behind a Dequantize.
std::vector<std::uint8_t> small_file() {
  TfliteWriter writer;
  const int image = writer.tensor({1, 5, 7, 3});
  const int half = writer.tensor({2, 1, 1, 3}, TfliteWriter::Float16,
                                 {0x00, 0x3C, 0x00, 0xC0, 0x00, 0x38, 0x00, 0x3C, 0x00, 0x00, 0x00, 0x80});
  const int weights = writer.tensor({2, 1, 1, 3});
  const int bias = writer.constant({2}, std::vector<float>{0.25F, -3.0F});
  const int result = writer.tensor({1, 3, 4, 2});
  writer.add(TfliteWriter::Dequantize, {half}, {weights});
  writer.add(TfliteWriter::Conv2d, {image, weights, bias}, {result}, test::conv_options(false, 2, 2));
  return writer.finish({image}, {result});
}

std::string error_of(const std::vector<std::uint8_t>& file) {
  try {
    parse_tflite(file, "some.tflite");
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return {};
}

TEST(TfliteModel, ReadsAGraph) {
  const auto file = small_file();
  const TfliteModel model = parse_tflite(file, "small");
  EXPECT_THAT(model.inputs, ElementsAre(0));
  EXPECT_THAT(model.outputs, ElementsAre(4));
  ASSERT_EQ(model.operators.size(), 2U);
  EXPECT_EQ(model.operators[0].kind, OperatorKind::Dequantize);
  const TfliteOperator& conv = model.operators[1];
  EXPECT_EQ(conv.kind, OperatorKind::Conv2d);
  EXPECT_EQ(conv.padding, PaddingMode::Same);
  EXPECT_EQ(conv.stride_rows, 2);
  EXPECT_EQ(conv.stride_columns, 2);
  EXPECT_THAT(conv.inputs, ElementsAre(0, 2, 3));
  EXPECT_THAT(model.tensors[4].shape, ElementsAre(1, 3, 4, 2));
  EXPECT_THAT(model.constant_floats(1), ElementsAre(1.0F, -2.0F, 0.5F, 1.0F, 0.0F, -0.0F));
  EXPECT_THAT(model.constant_floats(3), ElementsAre(0.25F, -3.0F));
  EXPECT_THROW(model.constant_floats(0), Error);
  EXPECT_THROW(model.constant_ints(3), Error);
}

TEST(TfliteModel, RefusesOtherFiles) {
  EXPECT_THAT(error_of({}), HasSubstr("some.tflite: not a TensorFlow Lite model"));
  EXPECT_THAT(error_of({'P', 'K', 3, 4, 'T', 'F', 'L', '2', 0, 0}), HasSubstr("not a TensorFlow Lite model"));
}

TEST(TfliteModel, RefusesWhatItDoesNotUnderstand) {
  const auto with = [](TfliteWriter::Builtin code, const std::vector<TfliteWriter::Option>& options,
                       const std::vector<int>& inputs) {
    TfliteWriter writer;
    writer.tensor({1, 4, 4, 3});
    writer.tensor({1, 4, 4, 3});
    writer.add(code, inputs, {1}, options);
    return error_of(writer.finish({0}, {1}));
  };
  EXPECT_THAT(with(TfliteWriter::Softmax, {}, {0}), HasSubstr("operator code 25 is not supported"));
  EXPECT_THAT(with(TfliteWriter::Add, {{0, 3, true}}, {0, 0}), HasSubstr("a fused activation is 3"));
  EXPECT_THAT(with(TfliteWriter::Conv2d, test::conv_options(false, 0x7FFFFFFF, 1), {0, 0, 0}),
              HasSubstr("a stride"));
  EXPECT_THAT(with(TfliteWriter::DepthwiseConv2d, {{1, 1}, {2, 1}, {3, 2}}, {0, 0, 0}),
              HasSubstr("a depth multiplier is 2"));
  EXPECT_THAT(with(TfliteWriter::DepthwiseConv2d, {{1, 1}, {2, 1}, {6, 3}}, {0, 0, 0}),
              HasSubstr("a dilation is 3"));
  EXPECT_THAT(with(TfliteWriter::MaxPool2d, test::pool_options(true, 2, 65), {0}),
              HasSubstr("a filter size is 65"));
  EXPECT_THAT(with(TfliteWriter::Mul, {{0, 1, true}}, {0, 0}), HasSubstr("a fused activation is 1"));
  EXPECT_THAT(with(TfliteWriter::Concatenation, {{0, -1}}, {0, 0}), HasSubstr("an axis is -1"));
  EXPECT_THAT(with(TfliteWriter::Relu, {}, {7}), HasSubstr("a tensor index is 7"));
  EXPECT_THAT(with(TfliteWriter::Relu, {}, {-2}), HasSubstr("a tensor index is -2"));
  EXPECT_THAT(with(TfliteWriter::Relu, {}, std::vector<int>(1000, 0)), HasSubstr("1000 operands"));
  EXPECT_THAT(with(TfliteWriter::Relu, {}, {0}), "");
}

TEST(TfliteModel, RefusesAFileWhoseTablesLeaveIt) {
  auto file = small_file();
  EXPECT_EQ(error_of(file), "");
  file.resize(file.size() - 4);
  EXPECT_THAT(error_of(file), HasSubstr("some.tflite: damaged"));
  auto elsewhere = small_file();
  elsewhere[3] = 0x7F;
  EXPECT_THAT(error_of(elsewhere), HasSubstr("some.tflite: damaged"));
}

TEST(TfliteModel, RefusesConstantsThatDoNotFillTheirShape) {
  TfliteWriter writer;
  writer.constant({3, 3}, std::vector<float>(8, 1.0F));
  EXPECT_THAT(error_of(writer.finish({0}, {0})), HasSubstr("32 bytes, which is not its shape"));
  TfliteWriter negative;
  negative.tensor({1, -4});
  EXPECT_THAT(error_of(negative.finish({0}, {0})), HasSubstr("a tensor's extent is -4"));
}

TEST(TfliteModel, EveryTruncationIsAnErrorOrAWholeModel) {
  const auto file = small_file();
  int errors = 0;
  for (std::size_t size = 0; size < file.size(); ++size) {
    // A heap copy of exactly this size, so that the address sanitizer sees a byte read too many.
    const std::vector<std::uint8_t> cut(file.begin(), file.begin() + static_cast<std::ptrdiff_t>(size));
    errors += error_of(cut).empty() ? 0 : 1;
  }
  EXPECT_GT(errors, static_cast<int>(file.size() / 2));
}

TEST(TfliteModel, EveryFlippedByteIsAnErrorOrAConsistentModel) {
  const auto file = small_file();
  for (std::size_t at = 0; at < file.size(); ++at) {
    for (const int flip : {0x01, 0x80, 0xFF}) {
      auto damaged = file;
      damaged[at] = static_cast<std::uint8_t>(damaged[at] ^ flip);
      try {
        const TfliteModel model = parse_tflite(damaged, "damaged");
        for (const TfliteOperator& op : model.operators) {
          for (const int input : op.inputs) {
            ASSERT_LT(input, static_cast<int>(model.tensors.size())) << "byte " << at;
          }
        }
      } catch (const Error& error) {
        ASSERT_THAT(error.what(), HasSubstr("damaged: ")) << "byte " << at;
      }
    }
  }
}

TEST(TfliteModel, WidensEveryHalf) {
  for (int bits = 0; bits < 0x10000; ++bits) {
    const int exponent = (bits >> 10) & 0x1F;
    const int fraction = bits & 0x3FF;
    const double sign = (bits & 0x8000) != 0 ? -1.0 : 1.0;
    const float value = float_from_half(static_cast<std::uint16_t>(bits));
    if (exponent == 31) {
      ASSERT_EQ(std::isinf(value), fraction == 0) << bits;
      ASSERT_EQ(std::isnan(value), fraction != 0) << bits;
      ASSERT_EQ(std::signbit(value), sign < 0) << bits;
    } else {
      const double expected =
          exponent == 0 ? std::ldexp(fraction, -24) : std::ldexp(1024 + fraction, exponent - 25);
      ASSERT_EQ(static_cast<double>(value), sign * expected) << bits;
    }
  }
}

}  // namespace
}  // namespace facet::landmark
