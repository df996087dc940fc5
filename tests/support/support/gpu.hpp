#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "gpu/context.hpp"

namespace facet::test {

/// One Vulkan device for the tests of a case, with the validation layers where they are installed. A case
/// that made them say anything fails; without a device it is skipped. Link ROOMS gpu.
class GpuTest : public ::testing::Test {
 protected:
  void SetUp() override {
    gpu::ContextOptions options;
    options.validation = gpu::Validation::IfAvailable;
    try {
      context_ = std::make_unique<gpu::Context>(options);
    } catch (const Error& error) {
      GTEST_SKIP() << error.what();
    }
    if (!context_->validation_active()) {
      RecordProperty("validation", "skipped: the layer is not installed");
    }
  }
  void TearDown() override { expect_no_validation_messages(); }

  void expect_no_validation_messages() const {
    if (context_ != nullptr) {
      for (const std::string& message : context_->validation_messages()) {
        ADD_FAILURE() << "validation: " << message;
      }
    }
  }

  gpu::Context& context() { return *context_; }
  void replace_context(std::unique_ptr<gpu::Context> context) { context_ = std::move(context); }

 private:
  std::unique_ptr<gpu::Context> context_;
};

}  // namespace facet::test
