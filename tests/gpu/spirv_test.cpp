#include "gpu/spirv.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

#include "facet/error.hpp"
#include "gpu/kernel.hpp"
#include "test_gpu_shaders.hpp"

namespace facet::gpu {
namespace {

std::vector<std::uint32_t> words_of(std::string_view name) {
  const ShaderSet set = shaders::test_gpu::kernels();
  const auto found = std::ranges::find(set, name, &Shader::name);
  EXPECT_NE(found, set.end());
  return {found->words.begin(), found->words.end()};
}

const BindingInfo& binding(const ShaderInterface& interface, std::string_view name) {
  const auto found = std::ranges::find(interface.bindings, name, &BindingInfo::name);
  if (found == interface.bindings.end()) {
    throw std::out_of_range(std::string(name));
  }
  return *found;
}

TEST(SpirvTest, ReadsResourcesByTheNamesOfTheCode) {
  const ShaderInterface scale = reflect(words_of("scale"));
  EXPECT_EQ(scale.entry_point, "main");
  EXPECT_EQ(scale.bindings.size(), 2U);
  EXPECT_EQ(binding(scale, "source").type, BindingType::TexelBuffer);
  EXPECT_EQ(binding(scale, "target").type, BindingType::StorageBuffer);
  EXPECT_NE(binding(scale, "source").binding, binding(scale, "target").binding);
  EXPECT_EQ(scale.push_constant_bytes, 24U);
  EXPECT_THAT(scale.workgroup_size, ::testing::ElementsAre(64U, 1U, 1U));

  const ShaderInterface constants = reflect(words_of("constants"));
  EXPECT_EQ(binding(constants, "parameters").type, BindingType::UniformBuffer);
  EXPECT_FALSE(binding(constants, "parameters").written);
  EXPECT_TRUE(binding(constants, "values").written);
  EXPECT_EQ(constants.push_constant_bytes, 0U);

  const ShaderInterface sample = reflect(words_of("sample_levels"));
  EXPECT_EQ(binding(sample, "pyramid").type, BindingType::SampledImage);

  const ShaderInterface accumulate = reflect(words_of("accumulate"));
  EXPECT_FALSE(binding(accumulate, "previous").written);
  EXPECT_TRUE(binding(accumulate, "previous").read);
  EXPECT_TRUE(binding(accumulate, "values").written);
  EXPECT_TRUE(binding(accumulate, "values").read);
}

TEST(SpirvTest, ReadsConstantsWithTypesAndDefaults) {
  const ShaderInterface interface = reflect(words_of("constants"));
  const auto constant = [&](std::string_view name) {
    const auto found = std::ranges::find(interface.constants, name, &ConstantInfo::name);
    EXPECT_NE(found, interface.constants.end()) << name;
    return *found;
  };
  EXPECT_EQ(constant("block").type, ConstantType::Uint);
  EXPECT_EQ(constant("block").default_bits, 4U);
  EXPECT_EQ(constant("block").id, 1U);
  EXPECT_EQ(constant("shift").type, ConstantType::Int);
  EXPECT_EQ(constant("shift").default_bits, static_cast<std::uint32_t>(-3));
  EXPECT_EQ(constant("weight").type, ConstantType::Float);
  EXPECT_EQ(std::bit_cast<float>(constant("weight").default_bits), 0.5F);
  EXPECT_EQ(constant("negate").type, ConstantType::Bool);
  EXPECT_EQ(constant("negate").default_bits, 0U);
  EXPECT_EQ(constant("local_size_x").id, 0U);
  EXPECT_GE(interface.workgroup_size_constant[0], 0);
  EXPECT_EQ(interface.workgroup_size_constant[1], -1);
}

TEST(SpirvTest, WhatIsNoModuleIsRefused) {
  EXPECT_THROW(reflect({}), Error);
  EXPECT_THROW(reflect(std::vector<std::uint32_t>{0x07230203, 0x10500, 0, 1}), Error) << "no header";
  EXPECT_THROW(reflect(std::vector<std::uint32_t>{0x07230203, 0x10500, 0, 1, 0}), Error) << "no entry point";
  std::vector<std::uint32_t> swapped = words_of("scale");
  swapped[0] = 0x03022307;
  EXPECT_THROW(reflect(swapped), Error) << "other byte order";
  std::vector<std::uint32_t> past_the_end{0x07230203, 0x10500, 0, 1, 0, (9U << 16U) | 5U, 1};
  EXPECT_THROW(reflect(past_the_end), Error);
  std::vector<std::uint32_t> no_length{0x07230203, 0x10500, 0, 1, 0, 5U, 1};
  EXPECT_THROW(reflect(no_length), Error);
}

TEST(SpirvTest, EveryTruncationIsReadOrRefused) {
  for (const Shader& shader : shaders::test_gpu::kernels()) {
    const std::size_t whole = reflect(shader.words).bindings.size();
    for (std::size_t length = 0; length < shader.words.size(); ++length) {
      try {
        EXPECT_LE(reflect(shader.words.first(length)).bindings.size(), whole);
      } catch (const Error& error) {
        EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      }
    }
  }
}

TEST(SpirvTest, RandomDamageIsReadOrRefused) {
  std::mt19937 random(20261121);
  const std::vector<std::uint32_t> good = words_of("constants");
  int refused = 0;
  for (int round = 0; round < 5000; ++round) {
    std::vector<std::uint32_t> damaged = good;
    for (int change = 0; change < 3; ++change) {
      damaged[random() % damaged.size()] ^= 1U << (random() % 32);
    }
    try {
      EXPECT_LE(reflect(damaged).bindings.size(), damaged.size());
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
      ++refused;
    }
  }
  EXPECT_GT(refused, 0);
}

}  // namespace
}  // namespace facet::gpu
