#include "gpu/image.hpp"

#include <gtest/gtest.h>

#include <algorithm>
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

constexpr std::uint32_t seed = 127;

class ImageTest : public test::GpuTest {};

/// An image level of four channels in float, rows packed.
struct Level {
  std::uint32_t width_px;
  std::uint32_t height_px;
  std::vector<float> values;  ///< [height][width][4]

  float at(std::uint32_t x, std::uint32_t y, std::size_t channel) const {
    return values[(std::size_t{y} * width_px + x) * 4 + channel];
  }
};

/// A half float of a value between 2^-14 and 65504, or 0, rounded to nearest.
std::uint16_t half_from_float(float value) {
  if (value == 0.0F) {
    return 0;
  }
  int exponent = 0;
  const float mantissa = std::frexp(std::abs(value), &exponent);
  const auto rounded = static_cast<std::uint32_t>(std::lround(mantissa * 2048.0F));  // 11 bits
  const std::uint32_t bits = (static_cast<std::uint32_t>(exponent + 13) << 10U) + rounded;
  return static_cast<std::uint16_t>(bits | (value < 0 ? 0x8000U : 0U));
}

float float_from_half(std::uint16_t half) {
  const int exponent = (half >> 10U) & 0x1FU;
  const auto mantissa = static_cast<float>(half & 0x3FFU);
  const float magnitude =
      exponent == 0 ? std::ldexp(mantissa, -24) : std::ldexp(mantissa + 1024.0F, exponent - 25);
  return (half & 0x8000U) != 0 ? -magnitude : magnitude;
}

std::vector<std::uint8_t> encode(const Level& level, ImageFormat format) {
  std::vector<std::uint8_t> bytes;
  for (const float value : level.values) {
    if (format == ImageFormat::Rgba8) {
      bytes.push_back(static_cast<std::uint8_t>(std::lround(value * 255.0F)));
    } else if (format == ImageFormat::Rgba16f) {
      const std::uint16_t half = half_from_float(value);
      bytes.push_back(static_cast<std::uint8_t>(half & 0xFFU));
      bytes.push_back(static_cast<std::uint8_t>(half >> 8U));
    } else {
      const auto raw = std::bit_cast<std::array<std::uint8_t, 4>>(value);
      bytes.insert(bytes.end(), raw.begin(), raw.end());
    }
  }
  return bytes;
}

std::vector<float> decode(const std::vector<std::uint8_t>& bytes, ImageFormat format) {
  std::vector<float> values;
  const std::size_t channel_bytes = pixel_bytes(format) / 4;
  for (std::size_t at = 0; at < bytes.size(); at += channel_bytes) {
    if (format == ImageFormat::Rgba8) {
      values.push_back(static_cast<float>(bytes[at]) / 255.0F);
    } else if (format == ImageFormat::Rgba16f) {
      values.push_back(float_from_half(static_cast<std::uint16_t>(bytes[at] | (bytes[at + 1] << 8U))));
    } else {
      values.push_back(std::bit_cast<float>(
          std::array<std::uint8_t, 4>{bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]}));
    }
  }
  return values;
}

Level read_level(Context& context, const Image& image, std::uint32_t level) {
  const Buffer back(context, image.level_bytes(level), Memory::Readback, "level");
  run_now(context, "read level", [&](Batch& batch) { batch.copy(image, level, back); });
  std::vector<std::uint8_t> bytes(image.level_bytes(level));
  download<std::uint8_t>(context, back, bytes);
  return {image.width_px(level), image.height_px(level), decode(bytes, image.format())};
}

Level random_level(std::uint32_t width_px, std::uint32_t height_px) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> colour(0.01F, 1.0F);
  Level level{width_px, height_px, std::vector<float>(std::size_t{4} * width_px * height_px)};
  std::ranges::generate(level.values, [&] { return colour(random); });
  return level;
}

TEST_F(ImageTest, LevelsComeBackAsTheyWentInAtOddSizes) {
  const std::array<std::array<std::uint32_t, 2>, 5> sizes{{{13, 127}, {127, 13}, {64, 64}, {1, 9}, {800, 3}}};
  constexpr ImageFormat format = ImageFormat::Rgba16f;
  for (const auto& [width_px, height_px] : sizes) {
    const Image image(context(), format, width_px, height_px, 0, "pyramid");
    EXPECT_EQ(image.level_count(), static_cast<std::uint32_t>(std::bit_width(std::max(width_px, height_px))));
    for (std::uint32_t level = 0; level < image.level_count(); ++level) {
      EXPECT_EQ(image.width_px(level), std::max(1U, width_px >> level));
      EXPECT_EQ(image.height_px(level), std::max(1U, height_px >> level));
      const std::vector<std::uint8_t> bytes =
          encode(random_level(image.width_px(level), image.height_px(level)), format);
      ASSERT_EQ(bytes.size(), image.level_bytes(level));
      const Buffer staging(context(), bytes.size(), Memory::Upload, "staging");
      upload<std::uint8_t>(context(), staging, bytes);
      run_now(context(), "level", [&](Batch& batch) { batch.copy(staging, image, level); });
      EXPECT_EQ(read_level(context(), image, level).values, decode(bytes, format))
          << width_px << "x" << height_px << " level " << level;
    }
  }
}

// Linear reading in the middle between pixel centres is their mean, outside it is the edge's pixel, and a
// fraction of a level mixes two levels, where the sampler says so.
TEST_F(ImageTest, SamplersFilterClampAndChooseLevels) {
  const Image image(context(), ImageFormat::Rgba32f, 4, 2, 2, "small");
  std::vector<float> base(4 * 2 * 4);
  for (std::size_t pixel = 0; pixel < 8; ++pixel) {
    base[pixel * 4] = static_cast<float>(pixel);
  }
  const std::vector<float> half{100, 0, 0, 0, 200, 0, 0, 0};
  const Buffer staging(context(), (base.size() + half.size()) * 4, Memory::Upload, "staging");
  upload<float>(context(), staging, base);
  upload<float>(context(), staging, half, base.size() * 4);
  const std::vector<vec4> places{{0.25F, 0.25F, 0.0F, 0.0F},   // between pixels 0 and 1 of row 0
                                 {-3.0F, 0.75F, 0.0F, 0.0F},   // left of row 1
                                 {9.0F, 9.0F, 0.0F, 0.0F},     // beyond the last corner
                                 {0.5F, 0.5F, 1.0F, 0.0F},     // level 1, middle
                                 {0.125F, 0.25F, 0.5F, 0.0F},  // half-way between levels at pixel 0
                                 {0.5F, 0.5F, 7.0F, 0.0F}};    // beyond the last level
  const Buffer place_buffer(context(), places.size() * sizeof(vec4), Memory::Upload, "places");
  upload<vec4>(context(), place_buffer, places);
  const TexelView place_view(place_buffer, TexelFormat::Rgba32f);
  const Buffer colours(context(), places.size() * sizeof(vec4), Memory::Readback, "colours");
  const Kernel kernel(context(), shaders::test_gpu::kernels(), "sample_levels");
  const auto sample = [&](const Sampler& sampler) {
    run_now(context(), "sample", [&](Batch& batch) {
      batch.copy(staging, image, 0);
      batch.copy(staging, image, 1, base.size() * 4);
      batch.dispatch(kernel, {{"pyramid", image, sampler}, {"places", place_view}, {"colours", colours}}, {1},
                     CountPush{static_cast<std::uint32_t>(places.size())});
    });
    std::vector<vec4> back(places.size());
    download<vec4>(context(), colours, back);
    return back;
  };
  const Sampler between(context(), Filter::Linear, Filter::Linear);
  const std::vector<vec4> linear = sample(between);
  // Filter weights have 8 bits at least (VkPhysicalDeviceLimits), so values up to 200 are good to 200 / 256.
  EXPECT_NEAR(linear[0].x, 0.5F, 1.0F / 256);
  EXPECT_NEAR(linear[1].x, 4.0F, 1e-6F);
  EXPECT_NEAR(linear[2].x, 7.0F, 1e-6F);
  EXPECT_NEAR(linear[3].x, 150.0F, 100.0F / 256);
  EXPECT_NEAR(linear[4].x, 50.0F, 100.0F / 256);
  EXPECT_NEAR(linear[5].x, 150.0F, 100.0F / 256);
  const Sampler nearest(context(), Filter::Nearest);
  const std::vector<vec4> plain = sample(nearest);
  EXPECT_EQ(plain[1].x, 4.0F);
  EXPECT_TRUE(plain[4].x == 0.0F || plain[4].x == 100.0F) << plain[4].x;
}

TEST_F(ImageTest, ImpossibleSizesAreRefused) {
  EXPECT_THROW(Image(context(), ImageFormat::Rgba8, 0, 4, 1, "no width"), Error);
  EXPECT_THROW(Image(context(), ImageFormat::Rgba8, 4, 4, 4, "too many levels"), Error);
  EXPECT_THROW(Image(context(), ImageFormat::Rgba8, 1 << 20, 1, 1, "too wide"), Error);
  const Image image(context(), ImageFormat::Rgba8, 4, 4, 2, "image");
  const Buffer buffer(context(), 64, Memory::Upload, "buffer");
  Batch batch(context(), "refused");
  EXPECT_THROW(batch.copy(buffer, image, 2), Error) << "no such level";
  EXPECT_THROW(batch.copy(buffer, image, 0, 4), Error) << "past the buffer's end";
  EXPECT_THROW(batch.copy(buffer, image, 1, 2), Error) << "half a pixel";
}

}  // namespace
}  // namespace facet::gpu
