#include "capture/depth_map.hpp"

#include <gtest/gtest.h>

#include <vector>

namespace facet::capture {
namespace {

DepthMap map_of(std::vector<float> sigma_mm) {
  DepthMap map;
  map.width_px = static_cast<int>(sigma_mm.size());
  map.height_px = 1;
  map.depth_mm.assign(sigma_mm.size(), 900.0F);
  map.confidence.assign(sigma_mm.size(), 0.3F);
  map.sigma_mm = std::move(sigma_mm);
  return map;
}

TEST(DepthMap, ConfidenceCountsInTheMapsOwnNoise) {
  std::vector<DepthMap> quiet = {map_of({0.1F, 0, 0.2F}), map_of({0.05F, 0.1F, 0.4F})};
  std::vector<DepthMap> noisy = {map_of({0.3F, 0, 0.6F}), map_of({0.15F, 0.3F, 1.2F})};
  weigh_by_own_noise(quiet);
  weigh_by_own_noise(noisy);
  EXPECT_FLOAT_EQ(quiet[0].confidence[0], 0.5F) << "0.1 is the median of both maps";
  EXPECT_EQ(quiet[0].confidence[1], 0) << "a hole";
  EXPECT_FLOAT_EQ(quiet[1].confidence[0], 0.8F);
  for (std::size_t map = 0; map < quiet.size(); ++map) {
    for (std::size_t pixel = 0; pixel < 3; ++pixel) {
      EXPECT_NEAR(quiet[map].confidence[pixel], noisy[map].confidence[pixel], 1e-5F);
    }
  }
}

TEST(DepthMap, MapsOfHolesStayAsTheyAre) {
  std::vector<DepthMap> holes = {map_of({0, 0})};
  holes[0].confidence = {0, 0};
  weigh_by_own_noise(holes);
  EXPECT_EQ(holes[0].confidence, (std::vector<float>{0, 0}));
  weigh_by_own_noise({});
}

}  // namespace
}  // namespace facet::capture
