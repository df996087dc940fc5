#include "camera/pixel_buffers.hpp"

#include <gtest/gtest.h>

#include <cstdint>
#include <set>
#include <vector>

namespace facet::camera {
namespace {

constexpr std::size_t kSize_bytes = 640 * 480 * 4;
using Pixels = std::shared_ptr<std::uint8_t[]>;

TEST(PixelBuffers, AreUsedAgain) {
  const auto pool = std::make_shared<PixelBuffers>();
  EXPECT_EQ(pool->count(), 0U);
  std::set<const std::uint8_t*> seen;
  for (int i = 0; i < 100; ++i) {
    std::vector<Pixels> held;
    for (std::size_t k = 0; k < PixelBuffers::kKept; ++k) {
      held.push_back(pool->take(kSize_bytes));
      seen.insert(held.back().get());
      EXPECT_EQ(reinterpret_cast<std::uintptr_t>(held.back().get()) % kRowAlignment_bytes, 0U);
    }
    EXPECT_EQ(pool->count(), PixelBuffers::kKept) << "from the first one on";
  }
  EXPECT_EQ(seen.size(), PixelBuffers::kKept);
}

TEST(PixelBuffers, WhatABurstTookIsFreed) {
  const auto pool = std::make_shared<PixelBuffers>();
  std::vector<Pixels> held;
  std::set<const std::uint8_t*> apart;
  for (std::uint8_t i = 0; i < 64; ++i) {
    held.push_back(pool->take(kSize_bytes));
    held.back()[0] = held.back()[kSize_bytes - 1] = i;
    apart.insert(held.back().get());
  }
  EXPECT_EQ(apart.size(), 64U);
  EXPECT_EQ(pool->count(), 64U);
  for (std::uint8_t i = 0; i < 64; ++i) {
    EXPECT_EQ(held[i][0], i);
    EXPECT_EQ(held[i][kSize_bytes - 1], i);
  }
  held.resize(20);
  EXPECT_EQ(pool->count(), 20U);
  held.clear();
  EXPECT_EQ(pool->count(), PixelBuffers::kKept);
}

TEST(PixelBuffers, AreReadAfterTheirCameraIsGone) {
  auto pool = std::make_shared<PixelBuffers>();
  const Pixels last = pool->take(kSize_bytes);
  pool.reset();
  last[kSize_bytes - 1] = 7;
  EXPECT_EQ(last[kSize_bytes - 1], 7);
}

}  // namespace
}  // namespace facet::camera
