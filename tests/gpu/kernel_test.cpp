#include "gpu/kernel.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "gpu/batch.hpp"
#include "gpu/buffer.hpp"
#include "shaders/layout.h"
#include "support/gpu.hpp"
#include "test_gpu_shaders.hpp"

namespace facet::gpu {
namespace {

using shaders::vec4;
using shaders::test_gpu::CountPush;
using shaders::test_gpu::ScalePush;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

ShaderSet set() {
  return shaders::test_gpu::kernels();
}

/// The message of the Error(Internal) that `misuse` throws.
template <typename Misuse>
std::string message_of(const Misuse& misuse) {
  try {
    misuse();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Internal);
    return error.what();
  }
  ADD_FAILURE() << "not refused";
  return {};
}

class KernelTest : public test::GpuTest {
 protected:
  std::vector<float> constants(const Kernel& kernel) {
    const Buffer parameters(context(), 2 * sizeof(vec4), Memory::Upload, "parameters");
    upload<float>(context(), parameters, std::vector<float>{10, 0, 0, 0, 0, 0, 0, 3});
    const Buffer values(context(), 5 * sizeof(float), Memory::Readback, "values");
    run_now(context(), "constants", [&](Batch& batch) {
      batch.dispatch(kernel, {{"parameters", parameters}, {"values", values}}, {1});
    });
    std::vector<float> back(5);
    download<float>(context(), values, back);
    return back;
  }
};

TEST_F(KernelTest, UnknownNameListsTheKernels) {
  const std::string message = message_of([&] { Kernel(context(), set(), "refine/no_such"); });
  EXPECT_THAT(message, HasSubstr("refine/no_such"));
  EXPECT_THAT(message, HasSubstr("accumulate"));
}

TEST_F(KernelTest, ConstantsKeepTheirDefaults) {
  const Kernel kernel(context(), set(), "constants");
  EXPECT_EQ(kernel.name(), "constants");
  EXPECT_THAT(kernel.workgroup_size(), ElementsAre(1U, 1U, 1U));
  EXPECT_THAT(constants(kernel), ElementsAre(4.0F, -3.0F, 0.5F, 1.0F, 13.0F));
}

TEST_F(KernelTest, ConstantsAreSetByName) {
  const Kernel kernel(
      context(), set(), "constants",
      {{"weight", 0.25F}, {"local_size_x", 32U}, {"block", 9U}, {"negate", true}, {"shift", -70}});
  EXPECT_THAT(kernel.workgroup_size(), ElementsAre(32U, 1U, 1U));
  EXPECT_THAT(constants(kernel), ElementsAre(9.0F, -70.0F, -0.25F, 32.0F, 13.0F));
}

TEST_F(KernelTest, WrongConstantsAreRefused) {
  EXPECT_THAT(message_of([&] {
                Kernel(context(), set(), "constants", {{"blok", 9U}});
              }),
              HasSubstr("uint block"));
  EXPECT_THAT(message_of([&] {
                Kernel(context(), set(), "constants", {{"block", 9}});
              }),
              HasSubstr("no specialization constant 'int block'"));
  EXPECT_THAT(message_of([&] {
                Kernel(context(), set(), "constants", {{"local_size_x", 1U << 20U}});
              }),
              HasSubstr("workgroup"));
}

TEST_F(KernelTest, WrongBindingsAreRefusedByName) {
  const Kernel kernel(context(), set(), "scale");
  const Buffer buffer(context(), 256, Memory::Device, "buffer");
  const TexelView view(buffer, TexelFormat::Rgba32f);
  const Buffer target(context(), 256, Memory::Device, "target");
  const Image image(context(), ImageFormat::Rgba8, 4, 4, 1, "image");
  const Sampler sampler(context());
  const ScalePush push{{0.0F, 0.0F, 0.0F, 0.0F}, 16, 1.0F};
  Batch batch(context(), "wrong");
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}}, {1}, push);
              }),
              HasSubstr("'target' of kernel 'scale' is not given"));
  EXPECT_THAT(
      message_of([&] {
        batch.dispatch(kernel, {{"source", view}, {"target", target}, {"targets", target}}, {1}, push);
      }),
      HasSubstr("uses no 'targets'; it uses: "));
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}, {"target", target}, {"source", view}}, {1}, push);
              }),
              HasSubstr("given twice"));
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", buffer}, {"target", target}}, {1}, push);
              }),
              HasSubstr("'source' of kernel 'scale' must be a texel view"));
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}, {"target", view}}, {1}, push);
              }),
              HasSubstr("must be a storage buffer"));
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}, {"target", image, sampler}}, {1}, push);
              }),
              HasSubstr("must be a storage buffer"));
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}, {"target", target, 16, 256}}, {1}, push);
              }),
              HasSubstr("outside its 256 bytes"));
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}, {"target", target, 300}}, {1}, push);
              }),
              HasSubstr("outside its 256 bytes"));
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}, {"target", target, 4}}, {1}, push);
              }),
              HasSubstr("no multiple of"));
}

TEST_F(KernelTest, WrongPushConstantsAreRefused) {
  const Kernel kernel(context(), set(), "scale");
  const Buffer buffer(context(), 256, Memory::Device, "buffer");
  const TexelView view(buffer, TexelFormat::Rgba32f);
  const Buffer target(context(), 256, Memory::Device, "target");
  Batch batch(context(), "wrong");
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}, {"target", target}}, {1});
              }),
              HasSubstr("takes 24 bytes of push constants, not 0"));
  EXPECT_THAT(message_of([&] {
                batch.dispatch(kernel, {{"source", view}, {"target", target}}, {1}, CountPush{1});
              }),
              HasSubstr("takes 24 bytes of push constants, not 4"));
  const Kernel none(context(), set(), "counts");
  EXPECT_THAT(message_of([&] {
                batch.dispatch(none, {{"wanted", buffer}, {"counts", target}}, {1}, CountPush{1});
              }),
              HasSubstr("takes 0 bytes of push constants, not 4"));
}

TEST_F(KernelTest, KnowsItsInterface) {
  const Kernel kernel(context(), set(), "scale");
  EXPECT_EQ(kernel.interface().push_constant_bytes, 24U);
  ASSERT_EQ(kernel.interface().bindings.size(), 2U);
  for (const BindingInfo& binding : kernel.interface().bindings) {
    if (binding.name == "source") {
      EXPECT_EQ(binding.type, BindingType::TexelBuffer);
      EXPECT_FALSE(binding.written);
    } else {
      EXPECT_EQ(binding.name, "target");
      EXPECT_EQ(binding.type, BindingType::StorageBuffer);
      EXPECT_TRUE(binding.written);
      EXPECT_FALSE(binding.read);
    }
  }
}

TEST_F(KernelTest, SubgroupsAndFloatAtomicsAddUp) {
  if (!context().info().has_float_atomics) {
    GTEST_SKIP() << "the device has no float atomics";
  }
  constexpr std::uint32_t count = 1000;
  std::vector<float> values(count);
  for (std::uint32_t index = 0; index < count; ++index) {
    values[index] = static_cast<float>(index % 17);
  }
  const Buffer from(context(), count * sizeof(float), Memory::Device, "values");
  upload<float>(context(), from, values);
  const Buffer sum(context(), sizeof(float), Memory::Readback, "sum");
  const Kernel kernel(context(), set(), "subgroup_sum");
  run_now(context(), "sum", [&](Batch& batch) {
    batch.fill(sum);
    batch.dispatch(kernel, {{"values", from}, {"sum", sum}}, {groups_for(count, 64)}, CountPush{count});
  });
  float expected = 0;  // whole numbers below 2^24: exact in any order
  for (const float value : values) {
    expected += value;
  }
  EXPECT_EQ(sum.mapped_as<float>()[0], expected);
}

}  // namespace
}  // namespace facet::gpu
