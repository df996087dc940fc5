#include "simulation/simulated_camera.hpp"

#include <gtest/gtest.h>

#include "support/synthetic_model.hpp"

namespace facet::simulation {
namespace {

TEST(SimulatedCamera, LivesLikeARecordedSource) {
  const face::FaceModel model = test::synthetic_model();
  StudioConfig config;
  config.width_px = 160;
  config.height_px = 120;
  config.frame_count = 3;
  config.rays_per_pixel = 1;
  const auto camera = make_simulated_camera(model, config);
  const CameraInfo info = camera->info();
  EXPECT_EQ(info.width_px, 160);
  EXPECT_EQ(info.frame_count, 3U);
  EXPECT_FALSE(info.live);
  ASSERT_TRUE(info.intrinsics.has_value());
  EXPECT_GT(info.intrinsics->fx, 50);

  Frame frame;
  EXPECT_EQ(camera->next(frame, std::chrono::milliseconds(1)), CaptureOutcome::EndOfStream);  // not started
  camera->start();
  const Studio studio(model, config);
  std::int64_t last_ns = 0;
  for (std::uint64_t k = 0; k < 3; ++k) {
    ASSERT_EQ(camera->next(frame, std::chrono::milliseconds(1)), CaptureOutcome::Delivered);
    EXPECT_EQ(frame.sequence, k);
    EXPECT_EQ(frame.media_time_ns, static_cast<std::int64_t>(k) * 1'000'000'000 / 30);
    EXPECT_GT(frame.timestamp_ns, last_ns);
    last_ns = frame.timestamp_ns;
    EXPECT_EQ(render::to_picture(frame).rgb, studio.render(static_cast<int>(k), nullptr).picture.rgb);
  }
  EXPECT_EQ(camera->next(frame, std::chrono::milliseconds(1)), CaptureOutcome::EndOfStream);
  EXPECT_TRUE(camera->last_error().empty());
  camera->stop();
  camera->stop();
}

}  // namespace
}  // namespace facet::simulation
