#include "pipeline/figures.hpp"

#include <gtest/gtest.h>

namespace facet::pipeline {
namespace {

TEST(Window, MeanAndQuantileOfTheLastValues) {
  Window window;
  EXPECT_EQ(window.mean(), 0);
  EXPECT_EQ(window.quantile(0.95F), 0);
  window.add(3);
  EXPECT_FLOAT_EQ(window.mean(), 3);
  EXPECT_FLOAT_EQ(window.quantile(0.95F), 3);
  for (std::size_t i = 0; i < Window::kLength; ++i) {
    window.add(static_cast<float>(i + 1));
  }
  EXPECT_FLOAT_EQ(window.mean(), 64.5F) << "the 3 has left the window";
  EXPECT_FLOAT_EQ(window.quantile(0), 1);
  EXPECT_FLOAT_EQ(window.quantile(0.5F), 65);
  EXPECT_FLOAT_EQ(window.quantile(0.95F), 122);
  EXPECT_FLOAT_EQ(window.quantile(1), 128);
}

TEST(MovingFigures, RateAndStages) {
  MovingFigures figures;
  mesh::MeshFrame frame;
  frame.stage_ms.fit_ms = 4;
  auto time = std::chrono::steady_clock::time_point(std::chrono::seconds(1));
  for (int i = 0; i < 10; ++i) {
    figures.add(frame, time);
    time += std::chrono::milliseconds(40);
  }
  PipelineStatus status;
  figures.fill(status);
  EXPECT_NEAR(status.frames_per_second, 25, 0.01);
  for (std::size_t s = 0; s < kStages.size(); ++s) {
    EXPECT_FLOAT_EQ(status.stages[s].mean_ms, std::string(kStages[s].name) == "fit" ? 4.0F : 0.0F);
  }
  EXPECT_EQ(status.photometric_rms, 0) << "no frame was refined";
}

}  // namespace
}  // namespace facet::pipeline
