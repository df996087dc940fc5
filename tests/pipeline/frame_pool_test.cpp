#include "pipeline/frame_pool.hpp"

#include <gtest/gtest.h>

#include <thread>

namespace facet::pipeline {
namespace {

TEST(FramePool, AFrameComesBackEmptyWithItsMemory) {
  FramePool pool;
  auto frame = pool.take();
  mesh::MeshFrame* address = frame.get();
  frame->sequence = 9;
  frame->state = mesh::TrackingState::Tracking;
  frame->degraded = true;
  frame->degraded_reason = "a reason";
  frame->displacements_mm.assign(1000, 1.0F);
  frame->expression_confidence.assign(51, 1.0F);
  frame->avatar_values.assign(51, 1.0F);
  frame->albedo = std::make_shared<const mesh::Albedo>();
  const std::weak_ptr<const mesh::Albedo> albedo = frame->albedo;
  frame.reset();
  EXPECT_TRUE(albedo.expired()) << "a frame on the shelf holds nothing of others";
  frame = pool.take();
  EXPECT_EQ(frame.get(), address);
  EXPECT_EQ(frame->sequence, 0U);
  EXPECT_EQ(frame->state, mesh::TrackingState::Searching);
  EXPECT_FALSE(frame->degraded);
  EXPECT_TRUE(frame->degraded_reason.empty());
  EXPECT_TRUE(frame->displacements_mm.empty());
  EXPECT_TRUE(frame->expression_confidence.empty());
  EXPECT_TRUE(frame->avatar_values.empty());
  EXPECT_GE(frame->expression_confidence.capacity(), 51U);
  EXPECT_GE(frame->displacements_mm.capacity(), 1000U);
}

TEST(FramePool, FramesMayOutliveThePool) {
  std::shared_ptr<mesh::MeshFrame> frame;
  {
    FramePool pool;
    frame = pool.take();
  }
  frame->sequence = 1;
  frame.reset();
}

TEST(FramePool, FramesComeBackFromOtherThreads) {
  FramePool pool;
  for (int i = 0; i < 1000; ++i) {
    std::shared_ptr<const mesh::MeshFrame> frame = pool.take();
    std::thread([held = std::move(frame)]() mutable { held.reset(); }).join();
  }
}

}  // namespace
}  // namespace facet::pipeline
