#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "gpu/buffer.hpp"
#include "gpu/context.hpp"

namespace facet::refine::test {

/// One device for the whole program, with validation layers where they are installed. Every test fails on any
/// message of theirs. Skipped where there is no device.
class GpuTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    try {
      context_ =
          std::make_unique<gpu::Context>(gpu::ContextOptions{.validation = gpu::Validation::IfAvailable});
    } catch (const Error& error) {
      why_not_ = error.what();
    }
  }
  static void TearDownTestSuite() { context_.reset(); }

  void SetUp() override {
    if (!context_) {
      GTEST_SKIP() << why_not_;
    }
  }
  void TearDown() override {
    if (context_) {
      for (const std::string& message : context_->validation_messages()) {
        ADD_FAILURE() << message;
      }
    }
  }

  static gpu::Context& context() { return *context_; }

 private:
  static inline std::unique_ptr<gpu::Context> context_;
  static inline std::string why_not_;
};

/// A device buffer with untouched room before and behind the part that a kernel is given.
class GuardedBuffer {
 public:
  GuardedBuffer(gpu::Context& context, std::size_t bytes)
      : guard_(std::max<std::size_t>(256, context.info().buffer_alignment_bytes)),
        bytes_(bytes),
        context_(context),
        buffer_(context, bytes + 2 * guard_, gpu::Memory::Device, "guarded") {
    const std::vector<std::byte> fill(bytes + 2 * guard_, kSentinel);
    gpu::upload(context, buffer_, std::as_bytes(std::span(fill)));
  }

  const gpu::Buffer& buffer() const { return buffer_; }
  std::size_t offset() const { return guard_; }
  std::size_t size() const { return bytes_; }

  template <typename T>
  void set(const std::vector<T>& values) {
    gpu::upload(context_, buffer_, std::as_bytes(std::span(values)), guard_);
  }
  template <typename T>
  std::vector<T> get() const {
    std::vector<T> values(bytes_ / sizeof(T));
    gpu::download(context_, buffer_, std::as_writable_bytes(std::span(values)), guard_);
    return values;
  }
  bool guards_intact() const {
    std::vector<std::byte> all(bytes_ + 2 * guard_);
    gpu::download(context_, buffer_, std::span<std::byte>(all));
    const auto untouched = [](std::byte b) { return b == kSentinel; };
    return std::all_of(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(guard_), untouched) &&
           std::all_of(all.end() - static_cast<std::ptrdiff_t>(guard_), all.end(), untouched);
  }

 private:
  static constexpr std::byte kSentinel{0xA5};
  std::size_t guard_;
  std::size_t bytes_;
  gpu::Context& context_;
  gpu::Buffer buffer_;
};

}  // namespace facet::refine::test
