#include "gpu/shader.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <stdexcept>
#include <string>

#include "test_gpu_shaders.hpp"

namespace facet::gpu {
namespace {

template <typename T>
const T& named(std::span<const T> all, std::string_view name) {
  const auto found = std::ranges::find(all, name, &T::name);
  if (found == all.end()) {
    throw std::out_of_range(std::string(name));
  }
  return *found;
}

const ShaderInterface& interface(std::string_view kernel) {
  return named(shaders::test_gpu::kernels(), kernel).interface;
}

const BindingInfo& binding(std::string_view kernel, std::string_view name) {
  return named(interface(kernel).bindings, name);
}

TEST(ShaderTest, KnowsResourcesByTheNamesOfTheCode) {
  EXPECT_EQ(interface("scale").bindings.size(), 2U);
  EXPECT_EQ(binding("scale", "source").type, BindingType::TexelBuffer);
  EXPECT_EQ(binding("scale", "target").type, BindingType::StorageBuffer);
  EXPECT_NE(binding("scale", "source").binding, binding("scale", "target").binding);
  EXPECT_EQ(interface("scale").push_constant_bytes, 24U);
  EXPECT_THAT(interface("scale").workgroup_size, ::testing::ElementsAre(64U, 1U, 1U));

  EXPECT_EQ(binding("constants", "parameters").type, BindingType::UniformBuffer);
  EXPECT_FALSE(binding("constants", "parameters").written);
  EXPECT_TRUE(binding("constants", "values").written);
  EXPECT_EQ(interface("constants").push_constant_bytes, 0U);

  EXPECT_EQ(binding("sample_levels", "pyramid").type, BindingType::SampledImage);

  EXPECT_FALSE(binding("accumulate", "previous").written);
  EXPECT_TRUE(binding("accumulate", "previous").read);
  EXPECT_TRUE(binding("accumulate", "values").written);
  EXPECT_TRUE(binding("accumulate", "values").read);
}

TEST(ShaderTest, KnowsConstantsWithTypesAndWhichSetTheWorkgroup) {
  const ShaderInterface& constants = interface("constants");
  EXPECT_EQ(named(constants.constants, "block").type, ConstantType::Uint);
  EXPECT_EQ(named(constants.constants, "block").id, 1U);
  EXPECT_EQ(named(constants.constants, "shift").type, ConstantType::Int);
  EXPECT_EQ(named(constants.constants, "weight").type, ConstantType::Float);
  EXPECT_EQ(named(constants.constants, "negate").type, ConstantType::Bool);
  EXPECT_EQ(named(constants.constants, "local_size_x").id, 0U);
  const auto setter = static_cast<std::size_t>(constants.workgroup_size_constant[0]);
  ASSERT_LT(setter, constants.constants.size());
  EXPECT_EQ(constants.constants[setter].name, "local_size_x");
  EXPECT_EQ(constants.workgroup_size_constant[1], -1);
}

}  // namespace
}  // namespace facet::gpu
