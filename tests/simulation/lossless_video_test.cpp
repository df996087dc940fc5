#include "simulation/lossless_video.hpp"

#include <gtest/gtest.h>

#include "camera/factory.hpp"
#include "facet/error.hpp"
#include "simulation/random.hpp"
#include "support/paths.hpp"

namespace facet::simulation {
namespace {

render::Picture noise(int width_px, int height_px, std::uint64_t seed) {
  Random random(seed, 0);
  render::Picture picture = render::plain_picture(width_px, height_px, {0, 0, 0});
  for (auto& value : picture.rgb) {
    value = static_cast<std::uint8_t>(random.below(256));
  }
  return picture;
}

TEST(LosslessVideo, DecodesToExactlyWhatWentIn) {
  for (const auto& [width, height] : {std::pair{64, 48}, {127, 13}}) {
    const test::TemporaryFolder folder;
    const auto file = folder.path() / "video.mkv";
    {
      LosslessVideo video(file, width, height, 30);
      for (std::uint64_t k = 0; k < 5; ++k) {
        video.append(noise(width, height, k));
      }
      video.finish();
    }
    const auto camera = camera::open_camera({.kind = "file", .path = file});
    EXPECT_EQ(camera->info().width_px, width);
    EXPECT_NEAR(camera->info().rate_hz, 30, 0.01);
    camera->start();
    Frame frame;
    for (std::uint64_t k = 0; k < 5; ++k) {
      ASSERT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::Delivered)
          << camera->last_error();
      EXPECT_EQ(render::to_picture(frame).rgb, noise(width, height, k).rgb) << k;
    }
    EXPECT_EQ(camera->next(frame, std::chrono::seconds(10)), CaptureOutcome::EndOfStream);
  }
}

TEST(LosslessVideo, RefusesWhatItCannotDo) {
  const test::TemporaryFolder folder;
  EXPECT_THROW(LosslessVideo(folder.path() / "a.mkv", 0, 10, 30), Error);
  EXPECT_THROW(LosslessVideo(folder.path() / "missing" / "a.mkv", 16, 16, 30), Error);
  LosslessVideo video(folder.path() / "b.mkv", 16, 16, 30);
  EXPECT_THROW(video.append(noise(17, 16, 1)), Error);
  video.append(noise(16, 16, 1));
  video.finish();
  EXPECT_NO_THROW(video.finish());
  EXPECT_THROW(video.append(noise(16, 16, 1)), Error);
}

}  // namespace
}  // namespace facet::simulation
