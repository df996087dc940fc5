#include "landmark/network.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "facet/error.hpp"
#include "landmark/landmark_assets.hpp"
#include "reference_graph.hpp"
#include "support/paths.hpp"
#include "tflite_writer.hpp"

namespace facet::landmark {
namespace {

using test::TfliteWriter;
using testing::HasSubstr;

constexpr unsigned seed = 20261121;

std::vector<float> noise(std::size_t count, std::mt19937& random) {
  std::uniform_real_distribution<float> values(-1, 1);
  std::vector<float> result(count);
  std::generate(result.begin(), result.end(), [&] { return values(random); });
  return result;
}

/// Runs a graph both ways on noise; returns the largest difference, relative to the largest value of its
/// output.
double difference_to_reference(const std::vector<std::uint8_t>& file) {
  const TfliteModel model = parse_tflite(file, "net");
  Network network(model, "net");
  std::mt19937 random(seed);
  const auto rows = static_cast<std::size_t>(network.input_rows());
  const auto columns = static_cast<std::size_t>(network.input_columns());
  const std::vector<float> image = noise(rows * columns * 3, random);
  for (std::size_t i = 0; i < rows * columns; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      network.input()[c * rows * columns + i] = image[3 * i + c];
    }
  }
  network.forward();
  const auto expected = test::run_reference(model, image);
  EXPECT_EQ(network.output_count(), expected.size());
  double worst = 0;
  for (std::size_t o = 0; o < expected.size(); ++o) {
    EXPECT_EQ(network.output(o).size(), expected[o].size());
    double largest = 1e-3;
    double difference = 0;
    for (std::size_t i = 0; i < expected[o].size(); ++i) {
      largest = std::max(largest, std::abs(static_cast<double>(expected[o][i])));
      difference = std::max(difference, std::abs(static_cast<double>(expected[o][i]) - network.output(o)[i]));
    }
    worst = std::max(worst, difference / largest);
  }
  return worst;
}

// Sums of up to a few hundred products in another order: some hundred units in the last place of a float.
constexpr double tolerance = 2e-5;

struct ConvCase {
  int rows, columns, kernel, stride;
  bool valid, depthwise;
};

class Convolution : public testing::TestWithParam<ConvCase> {};

TEST_P(Convolution, MatchesTheReference) {
  const auto [rows, columns, kernel, stride, valid, depthwise] = GetParam();
  const auto extent = [&, s = stride, k = kernel, v = valid](int in) {
    return v ? (in - k) / s + 1 : (in + s - 1) / s;
  };
  constexpr int channels = 3;
  const int outputs = depthwise ? channels : 5;
  std::mt19937 random(seed);
  TfliteWriter writer;
  const int image = writer.tensor({1, rows, columns, channels});
  const std::vector<int> shape = depthwise ? std::vector<int>{1, kernel, kernel, outputs}
                                           : std::vector<int>{outputs, kernel, kernel, channels};
  const auto count = static_cast<std::size_t>(kernel * kernel * (depthwise ? outputs : outputs * channels));
  const int weights = writer.constant(shape, noise(count, random));
  const int bias = writer.constant({outputs}, noise(static_cast<std::size_t>(outputs), random));
  const int convolved = writer.tensor({1, extent(rows), extent(columns), outputs});
  writer.add(
      depthwise ? TfliteWriter::DepthwiseConv2d : TfliteWriter::Conv2d, {image, weights, bias}, {convolved},
      depthwise ? test::depthwise_options(valid, stride, stride) : test::conv_options(valid, stride, stride));
  const int slopes = writer.constant({1, 1, outputs}, noise(static_cast<std::size_t>(outputs), random));
  const int result = writer.tensor({1, extent(rows), extent(columns), outputs});
  writer.add(TfliteWriter::Prelu, {convolved, slopes}, {result});
  EXPECT_LT(difference_to_reference(writer.finish({image}, {result})), tolerance);
}

INSTANTIATE_TEST_SUITE_P(
    Shapes, Convolution,
    testing::Values(ConvCase{12, 12, 3, 1, false, false}, ConvCase{12, 12, 3, 2, false, false},
                    ConvCase{13, 7, 3, 2, false, false}, ConvCase{16, 16, 5, 2, false, false},
                    ConvCase{13, 17, 1, 1, true, false}, ConvCase{12, 12, 3, 3, true, false},
                    ConvCase{3, 3, 3, 3, true, false}, ConvCase{12, 12, 3, 1, false, true},
                    ConvCase{12, 12, 3, 2, false, true}, ConvCase{13, 7, 3, 2, false, true},
                    ConvCase{96, 96, 3, 2, false, true}, ConvCase{127, 13, 3, 1, false, true}));

TEST(Network, MatchesTheReferenceOnABlockWithDownsampling) {
  // Max pooling and channel padding beside a convolution, added: the building block of both nets.
  std::mt19937 random(seed);
  for (const bool valid : {false, true}) {
    TfliteWriter writer;
    const int image = writer.tensor({1, 14, 10, 3});
    const int weights = writer.constant({7, 3, 3, 3}, noise(189, random));
    const int bias = writer.constant({7}, noise(7, random));
    const int convolved = writer.tensor({1, 7, 5, 7});
    writer.add(TfliteWriter::Conv2d, {image, weights, bias}, {convolved}, test::conv_options(false, 2, 2));
    const int pooled = writer.tensor({1, 7, 5, 3});
    writer.add(TfliteWriter::MaxPool2d, {image}, {pooled}, test::pool_options(valid, 2, 2));
    const int widths = writer.constant({4, 2}, std::vector<std::int32_t>{0, 0, 0, 0, 0, 0, 0, 4});
    const int padded = writer.tensor({1, 7, 5, 7});
    writer.add(TfliteWriter::Pad, {pooled, widths}, {padded});
    const int sum = writer.tensor({1, 7, 5, 7});
    writer.add(TfliteWriter::Add, {padded, convolved}, {sum});
    const int result = writer.tensor({1, 7, 5, 7});
    writer.add(TfliteWriter::Relu, {sum}, {result});
    EXPECT_LT(difference_to_reference(writer.finish({image}, {result, pooled})), tolerance);
  }
}

TEST(Network, DoesAnAdditionAndItsSlopesWithTheConvolutionBefore) {
  // As in both nets: what is added is there already. 37 pixels and 11 channels fill neither tile nor group.
  std::mt19937 random(seed);
  for (const bool read_twice : {false, true}) {
    TfliteWriter writer;
    const int image = writer.tensor({1, 37, 1, 3});
    const auto convolve = [&](int in, int channels) {
      const int weights =
          writer.constant({11, 1, 1, channels}, noise(static_cast<std::size_t>(11 * channels), random));
      const int bias = writer.constant({11}, noise(11, random));
      const int out = writer.tensor({1, 37, 1, 11});
      writer.add(TfliteWriter::Conv2d, {in, weights, bias}, {out}, test::conv_options(false, 1, 1));
      return out;
    };
    const int first = convolve(image, 3);
    const int second = convolve(first, 11);
    const int sum = writer.tensor({1, 37, 1, 11});
    writer.add(TfliteWriter::Add, {second, first}, {sum});
    const int slopes = writer.constant({1, 1, 11}, noise(11, random));
    const int result = writer.tensor({1, 37, 1, 11});
    writer.add(TfliteWriter::Prelu, {sum, slopes}, {result});
    const std::vector<int> outputs =
        read_twice ? std::vector<int>{result, second, sum} : std::vector<int>{result};
    EXPECT_LT(difference_to_reference(writer.finish({image}, outputs)), tolerance) << read_twice;
  }
}

TEST(Network, KeepsTensorFlowsOrderThroughReshapeAndConcatenation) {
  std::mt19937 random(seed);
  TfliteWriter writer;
  const int image = writer.tensor({1, 4, 6, 3});
  const auto head = [&](int outputs) {
    const int weights =
        writer.constant({outputs, 1, 1, 3}, noise(static_cast<std::size_t>(3 * outputs), random));
    const int bias = writer.constant({outputs}, noise(static_cast<std::size_t>(outputs), random));
    const int map = writer.tensor({1, 4, 6, outputs});
    writer.add(TfliteWriter::Conv2d, {image, weights, bias}, {map}, test::conv_options(false, 1, 1));
    const int list = writer.tensor({1, 24 * outputs / 2, 2});
    writer.add(TfliteWriter::Reshape, {map}, {list});
    return list;
  };
  const int first = head(4);
  const int second = head(6);
  const int all = writer.tensor({1, 48 + 72, 2});
  writer.add(TfliteWriter::Concatenation, {first, second}, {all}, {{0, 1}});
  EXPECT_LT(difference_to_reference(writer.finish({image}, {all})), tolerance);
}

TEST(Network, RefusesGraphsThatItCannotRun) {
  const auto error_of = [](const TfliteWriter& writer, int input, int output) -> std::string {
    const auto file = writer.finish({input}, {output});
    try {
      Network network(parse_tflite(file, "net"), "net");
    } catch (const Error& error) {
      return error.what();
    }
    return {};
  };
  TfliteWriter grey;
  grey.tensor({1, 4, 4, 1});
  EXPECT_THAT(error_of(grey, 0, 0), HasSubstr("net: the net must have one RGB image"));
  TfliteWriter custom;
  custom.tensor({1, 4, 4, 3});
  custom.tensor({1, 4, 4, 3});
  custom.add(TfliteWriter::Custom, {0}, {1}, {}, "Mystery");
  EXPECT_THAT(error_of(custom, 0, 1), HasSubstr("Mystery"));
  TfliteWriter unordered;
  unordered.tensor({1, 4, 4, 3});
  unordered.tensor({1, 4, 4, 3});
  unordered.tensor({1, 4, 4, 3});
  unordered.add(TfliteWriter::Relu, {2}, {1});
  EXPECT_THAT(error_of(unordered, 0, 1), HasSubstr("used before it is computed"));
  TfliteWriter short_bias;
  short_bias.tensor({1, 4, 4, 3});
  short_bias.constant({2, 1, 1, 3}, std::vector<float>(6, 1));
  short_bias.constant({1}, std::vector<float>(1, 1));
  short_bias.tensor({1, 4, 4, 2});
  short_bias.add(TfliteWriter::Conv2d, {0, 1, 2}, {3}, test::conv_options(false, 1, 1));
  EXPECT_THAT(error_of(short_bias, 0, 3), HasSubstr("bias does not fit"));

  // Shapes are the graph's word: none is believed, and none makes room that the net does not need.
  const auto pooled = [&](const std::vector<int>& from, const std::vector<int>& to) {
    TfliteWriter writer;
    writer.tensor(from);
    writer.tensor(to);
    writer.add(TfliteWriter::MaxPool2d, {0}, {1}, test::pool_options(true, 2, 2));
    return error_of(writer, 0, 1);
  };
  EXPECT_EQ(pooled({1, 4, 4, 3}, {1, 2, 2, 3}), "");
  EXPECT_THAT(pooled({1, 4, 4, 3}, {1, 2, 3, 3}), HasSubstr("has not the shape"));
  EXPECT_THAT(pooled({1, 4, 4, 3}, {1, 2, 2, 4}), HasSubstr("has not the shape"));
  EXPECT_THAT(pooled({1, 1, 4, 3}, {1, 1, 2, 3}), HasSubstr("has not the shape"));
  EXPECT_THAT(pooled({1, 1 << 24, 1 << 24, 3}, {1, 1 << 23, 1 << 23, 3}), HasSubstr("too large"));
  TfliteWriter unlike;
  unlike.tensor({1, 4, 4, 3});
  unlike.tensor({1, 2, 2, 3});
  unlike.tensor({1, 4, 4, 3});
  unlike.add(TfliteWriter::MaxPool2d, {0}, {1}, test::pool_options(true, 2, 2));
  unlike.add(TfliteWriter::Add, {0, 1}, {2});
  EXPECT_THAT(error_of(unlike, 0, 2), HasSubstr("two shapes"));
  TfliteWriter twice;
  twice.tensor({1, 4, 4, 3});
  twice.tensor({1, 4, 4, 3});
  twice.add(TfliteWriter::Relu, {0}, {1});
  twice.add(TfliteWriter::Relu, {0}, {1});
  EXPECT_THAT(error_of(twice, 0, 1), HasSubstr("computed twice"));
}

TEST(Network, RunsTheRealNetsAsTheReferenceDoes) {
  const auto file = test::assets() / "mediapipe/face_mesh_solution_packed_assets.data";
  if (!std::filesystem::exists(file)) {
    GTEST_SKIP() << file << " is missing (packaging/fetch-assets)";
  }
  const LandmarkAssets assets = LandmarkAssets::load(file);
  for (const auto part : {assets.detector(), assets.landmarks()}) {
    EXPECT_LT(difference_to_reference({part.begin(), part.end()}), 1e-4);
  }
}

}  // namespace
}  // namespace facet::landmark
