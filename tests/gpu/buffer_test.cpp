#include "gpu/buffer.hpp"

#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <cmath>
#include <random>
#include <vector>

#include "gpu/batch.hpp"
#include "shaders/layout.h"
#include "support/gpu.hpp"
#include "test_gpu_shaders.hpp"

namespace facet::gpu {
namespace {

using shaders::vec4;
using shaders::test_gpu::CountPush;
using shaders::test_gpu::ScalePush;
namespace kernels = shaders::test_gpu;

constexpr std::uint32_t seed = 20261121;
constexpr std::byte sentinel{0xA5};

class BufferTest : public test::GpuTest {};

std::vector<std::byte> random_bytes(std::size_t count) {
  std::mt19937 random(seed);
  std::vector<std::byte> bytes(count);
  for (std::byte& byte : bytes) {
    byte = static_cast<std::byte>(random() & 0xFFU);
  }
  return bytes;
}

// Sizes that are no multiples of anything, in all memories, at an offset, with the bytes around untouched.
TEST_F(BufferTest, RoundTripLeavesTheRestAlone) {
  for (const Memory memory : {Memory::Device, Memory::Upload, Memory::Readback}) {
    for (const std::size_t size : {std::size_t{1}, std::size_t{13}, std::size_t{127}, std::size_t{4099}}) {
      constexpr std::size_t margin = 64;
      const Buffer buffer(context(), size + 2 * margin, memory, "round trip");
      EXPECT_EQ(buffer.size_bytes(), size + 2 * margin);
      EXPECT_EQ(buffer.mapped().empty(), memory == Memory::Device);
      upload<std::byte>(context(), buffer, std::vector<std::byte>(size + 2 * margin, sentinel));
      const std::vector<std::byte> bytes = random_bytes(size);
      upload<std::byte>(context(), buffer, bytes, margin);
      std::vector<std::byte> back(size + 2 * margin);
      download<std::byte>(context(), buffer, back);
      std::vector<std::byte> expected(size + 2 * margin, sentinel);
      std::copy(bytes.begin(), bytes.end(), expected.begin() + margin);
      EXPECT_EQ(back, expected) << size << " bytes";
    }
  }
}

TEST_F(BufferTest, RangesOutsideAreRefused) {
  const Buffer buffer(context(), 16, Memory::Device, "small");
  std::array<std::byte, 17> bytes{};
  EXPECT_THROW(upload<std::byte>(context(), buffer, bytes), Error);
  EXPECT_THROW(download<std::byte>(context(), buffer, std::span(bytes).first(1), 16), Error);
  EXPECT_THROW(upload<std::byte>(context(), buffer, std::span<const std::byte>(bytes).first(8),
                                 std::numeric_limits<std::size_t>::max() - 3),
               Error);
  EXPECT_THROW(Buffer(context(), 0, Memory::Device, "empty"), Error);
  EXPECT_THROW(Buffer(context(), context().info().max_storage_buffer_bytes + 1, Memory::Device, "huge"),
               Error);
}

TEST_F(BufferTest, FillSetsWordsOfARangeOnly) {
  const Buffer buffer(context(), 13 * 4 + 3, Memory::Device, "fill");
  run_now(context(), "fill", [&](Batch& batch) {
    batch.fill(buffer, 0x01020304);
    batch.fill(buffer, 7, 8, 12);
  });
  std::vector<std::uint32_t> back(13);
  download<std::uint32_t>(context(), buffer, back);
  for (std::size_t word = 0; word < back.size(); ++word) {
    EXPECT_EQ(back[word], word >= 2 && word < 5 ? 7U : 0x01020304U) << word;
  }
}

/// Bytes of one element of every float format and what a kernel must read from them.
struct FloatFormat {
  TexelFormat format;
  std::array<float, 4> value;
  std::vector<std::uint8_t> bytes;
};

std::vector<std::uint8_t> bytes_of(std::initializer_list<float> values) {
  std::vector<std::uint8_t> bytes;
  for (const float value : values) {
    const auto raw = std::bit_cast<std::array<std::uint8_t, 4>>(value);
    bytes.insert(bytes.end(), raw.begin(), raw.end());
  }
  return bytes;
}

// Half floats by their bits: 1.0 = 3C00, -2.5 = C100, 0.333251953125 = 3555, 65504 = 7BFF. Colours of eight
// bits are multiples of 1/255, to the rounding of one float.
TEST_F(BufferTest, TexelViewsReadEveryFloatFormat) {
  const std::vector<FloatFormat> formats{
      {TexelFormat::Rgba32f, {1.5F, -2.25F, 3e-20F, 4e20F}, bytes_of({1.5F, -2.25F, 3e-20F, 4e20F})},
      {TexelFormat::Rg32f, {1.5F, -2.25F, 0.0F, 1.0F}, bytes_of({1.5F, -2.25F})},
      {TexelFormat::R32f, {-7.125F, 0.0F, 0.0F, 1.0F}, bytes_of({-7.125F})},
      {TexelFormat::Rgba16f,
       {1.0F, -2.5F, 0.333251953125F, 65504.0F},
       {0x00, 0x3C, 0x00, 0xC1, 0x55, 0x35, 0xFF, 0x7B}},
      {TexelFormat::Rg16f, {1.0F, -2.5F, 0.0F, 1.0F}, {0x00, 0x3C, 0x00, 0xC1}},
      {TexelFormat::R16f, {0.333251953125F, 0.0F, 0.0F, 1.0F}, {0x55, 0x35}},
      {TexelFormat::Rgba8, {0.0F, 51.0F / 255.0F, 128.0F / 255.0F, 1.0F}, {0, 51, 128, 255}}};
  const Kernel scale(context(), kernels::kernels(), "scale");
  constexpr std::uint32_t count = 127;
  for (const FloatFormat& format : formats) {
    ASSERT_EQ(format.bytes.size(), texel_bytes(format.format));
    std::vector<std::uint8_t> source;
    for (std::uint32_t index = 0; index < count; ++index) {
      source.insert(source.end(), format.bytes.begin(), format.bytes.end());
    }
    const Buffer from(context(), source.size(), Memory::Device, "from");
    const Buffer to(context(), (count + 1) * sizeof(vec4), Memory::Device, "to");
    upload<std::uint8_t>(context(), from, source);
    const TexelView view(from, format.format);
    run_now(context(), "read", [&](Batch& batch) {
      batch.fill(to, 0x7FC00000);  // a NaN, also behind the last element
      batch.dispatch(scale, {{"source", view}, {"target", to}}, {groups_for(count, 64)},
                     ScalePush{{0.0F, 0.0F, 0.0F, 0.0F}, count, 1.0F});
    });
    std::vector<vec4> back(count + 1);
    download<vec4>(context(), to, back);
    for (std::uint32_t index = 0; index < count; ++index) {
      EXPECT_FLOAT_EQ(back[index].x, format.value[0]);
      EXPECT_FLOAT_EQ(back[index].y, format.value[1]);
      EXPECT_FLOAT_EQ(back[index].z, format.value[2]);
      EXPECT_FLOAT_EQ(back[index].w, format.value[3]);
    }
    EXPECT_TRUE(std::isnan(back[count].x)) << "written behind the end";
  }
}

TEST_F(BufferTest, TexelViewsReadEveryIntegerFormat) {
  constexpr std::uint32_t count = 13;
  const std::array<std::int32_t, 4> values{-1, 2'000'000'000, -2'000'000'000, 7};
  const Kernel widen(context(), kernels::kernels(), "widen_integers");
  for (const TexelFormat format : {TexelFormat::R32i, TexelFormat::Rg32i, TexelFormat::Rgba32i}) {
    const std::size_t channels = texel_bytes(format) / 4;
    std::vector<std::int32_t> source;
    for (std::size_t index = 0; index < count * channels; ++index) {
      source.push_back(values[index % channels] + static_cast<std::int32_t>(index / channels));
    }
    const Buffer from(context(), source.size() * 4, Memory::Device, "from");
    const Buffer to(context(), count * 16, Memory::Device, "to");
    upload<std::int32_t>(context(), from, source);
    const TexelView view(from, format);
    run_now(context(), "read", [&](Batch& batch) {
      batch.dispatch(widen, {{"source", view}, {"target", to}}, {1}, CountPush{count});
    });
    std::vector<std::int32_t> back(count * 4);
    download<std::int32_t>(context(), to, back);
    for (std::size_t index = 0; index < count; ++index) {
      for (std::size_t channel = 0; channel < channels; ++channel) {
        EXPECT_EQ(back[index * 4 + channel], source[index * channels + channel]);
      }
    }
  }

  const Kernel widen_unsigned(context(), kernels::kernels(), "widen_unsigned");
  const std::vector<std::uint32_t> source{0, 1, 0x80000000U, 0xFFFFFFFFU};
  const Buffer from(context(), 16, Memory::Device, "from");
  const Buffer to(context(), 64, Memory::Device, "to");
  upload<std::uint32_t>(context(), from, source);
  const TexelView view(from, TexelFormat::R32u);
  run_now(context(), "read", [&](Batch& batch) {
    batch.dispatch(widen_unsigned, {{"source", view}, {"target", to}}, {1}, CountPush{4});
  });
  std::vector<std::uint32_t> back(16);
  download<std::uint32_t>(context(), to, back);
  for (std::size_t index = 0; index < 4; ++index) {
    EXPECT_EQ(back[index * 4], source[index]);
  }
}

TEST_F(BufferTest, TexelViewsOfAPartStartThere) {
  const std::size_t alignment = context().info().buffer_alignment_bytes;
  const Buffer from(context(), alignment + 64, Memory::Device, "from");
  std::vector<float> source((alignment + 64) / 4);
  for (std::size_t index = 0; index < source.size(); ++index) {
    source[index] = static_cast<float>(index);
  }
  upload<float>(context(), from, source);
  const TexelView view(from, TexelFormat::R32f, alignment, 16);
  const Buffer to(context(), 16 * sizeof(vec4), Memory::Device, "to");
  const Kernel scale(context(), kernels::kernels(), "scale");
  run_now(context(), "read", [&](Batch& batch) {
    batch.dispatch(scale, {{"source", view}, {"target", to}}, {1},
                   ScalePush{{1.0F, 0.0F, 0.0F, 0.0F}, 16, 2.0F});
  });
  std::vector<vec4> back(16);
  download<vec4>(context(), to, back);
  for (std::size_t index = 0; index < 16; ++index) {
    EXPECT_EQ(back[index].x, 2.0F * source[alignment / 4 + index] + 1.0F);
  }
  EXPECT_THROW(TexelView(from, TexelFormat::R32f, 4), Error) << "not aligned";
  EXPECT_THROW(TexelView(from, TexelFormat::R32f, alignment, 17), Error) << "past the end";
  EXPECT_THROW(TexelView(from, TexelFormat::R32f, 1 << 20), Error) << "starts past the end";
}

// What the host writes into a mapped buffer before a submission, that submission sees; nothing is recorded
// again.
TEST_F(BufferTest, MappedBuffersCarryParametersFromFrameToFrame) {
  const Buffer parameters(context(), 4 * sizeof(float), Memory::Upload, "parameters");
  const TexelView view(parameters, TexelFormat::Rgba32f);
  const Buffer result(context(), sizeof(vec4), Memory::Readback, "result");
  const Kernel scale(context(), kernels::kernels(), "scale");
  Batch batch(context(), "frame");
  batch.dispatch(scale, {{"source", view}, {"target", result}}, {1},
                 ScalePush{{0.5F, 0.0F, 0.0F, 0.0F}, 1, 3.0F});
  batch.finish();
  for (int frame = 0; frame < 20; ++frame) {
    parameters.mapped_as<float>()[0] = static_cast<float>(frame);
    ASSERT_EQ(batch.submit(), Outcome::Done);
    ASSERT_EQ(batch.wait(), Outcome::Done);
    EXPECT_EQ(result.mapped_as<float>()[0], 3.0F * static_cast<float>(frame) + 0.5F);
  }
}

}  // namespace
}  // namespace facet::gpu
