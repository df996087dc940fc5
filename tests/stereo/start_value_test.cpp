#include "stereo/start_value.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "facet/error.hpp"

namespace facet::stereo {
namespace {

constexpr int kWidth = 96;
constexpr int kHeight = 24;
constexpr int kNear_px = 11;
constexpr int kFar_px = 3;
constexpr int kEdge = 48;  ///< left of it far, right of it near

struct Pictures {
  VolumeSize size;
  std::vector<float> left, right;
};

/// Random grey on two plates, the near one to the right, seen by a left camera of other gain than the right
/// one's.
Pictures two_plates(int slots, int blank) {
  Pictures out;
  out.size = {kWidth, kHeight, slots};
  out.left.assign(out.size.voxels(), -1.0F);
  out.right.assign(out.size.voxels(), -1.0F);
  std::mt19937 random(5);
  std::uniform_real_distribution<float> uniform(0.2F, 0.9F);
  for (int t = 0; t < slots; ++t) {
    for (int y = 0; y < kHeight; ++y) {
      std::vector<float> far(kWidth + 32);
      std::vector<float> near(kWidth + 32);
      std::generate(far.begin(), far.end(), [&] { return uniform(random); });
      std::generate(near.begin(), near.end(), [&] { return uniform(random); });
      if (t == blank) {
        continue;
      }
      for (int x = 0; x < kWidth; ++x) {
        // Left pixel x of the near plate is right pixel x - 11, of the far one x - 3.
        const bool near_left = x >= kEdge;
        const bool near_right = x >= kEdge - kNear_px;
        const auto left_index = static_cast<std::size_t>(x - (near_left ? kNear_px : kFar_px) + 16);
        const auto right_index = static_cast<std::size_t>(x + 16);
        out.left[out.size.voxel(x, y, t)] = 0.8F * (near_left ? near : far)[left_index] + 0.1F;
        out.right[out.size.voxel(x, y, t)] = (near_right ? near : far)[right_index];
      }
    }
  }
  return out;
}

TEST(StartValueMemory, IsThatOfTheCostsAndALittleBeside) {
  // 128 disparities of 640 x 480 px: a byte each, two for the sums over the paths.
  const std::size_t costs = std::size_t{640} * 480 * 128 * 3;
  const std::size_t bytes = StartValue(640, 480, -64, 63, {}).bytes();
  EXPECT_GT(bytes, costs);
  EXPECT_LT(bytes, costs * 5 / 4);
  EXPECT_GT(StartValue(1280, 960, -128, 127, {}).bytes(), 7 * bytes);
}

class StartMethods : public ::testing::TestWithParam<StartMethod> {};

TEST_P(StartMethods, FindsBothPlatesAndNothingBetween) {
  const Pictures pictures = two_plates(1, -1);
  StartOptions options;
  options.method = GetParam();
  options.window_t = 1;
  StartValue start(kWidth, kHeight, 0, 15, options);
  std::vector<float> found(pictures.size.slot_voxels());
  start.find(pictures.size, pictures.left, pictures.right, 0, found);
  int right_ones = 0;
  int compared = 0;
  int hidden = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = kNear_px + 4; x < kWidth - 4; ++x) {
      const float d = found[pictures.size.voxel(x, y, 0)];
      // The far plate's last pixels lie behind the near one for the right camera.
      if (x >= kEdge - (kNear_px - kFar_px) && x < kEdge) {
        hidden += std::isnan(d) ? 1 : 0;
        continue;
      }
      ++compared;
      right_ones += std::abs(d - static_cast<float>(x >= kEdge ? kNear_px : kFar_px)) <= 0.5F ? 1 : 0;
    }
  }
  EXPECT_GT(right_ones, 0.95 * compared);
  EXPECT_GT(hidden, 0.8 * (kNear_px - kFar_px) * kHeight);
}

TEST_P(StartMethods, BlankSlotsTakeTheirNeighbours) {
  const Pictures pictures = two_plates(3, 1);
  StartOptions options;
  options.method = GetParam();
  options.window_t = 3;
  StartValue start(kWidth, kHeight, 0, 15, options);
  std::vector<float> found(pictures.size.slot_voxels());
  start.find(pictures.size, pictures.left, pictures.right, 1, found);
  EXPECT_NEAR(found[pictures.size.voxel(30, 12, 0)], kFar_px, 0.5);
  EXPECT_NEAR(found[pictures.size.voxel(70, 12, 0)], kNear_px, 0.5);
  options.window_t = 1;
  StartValue alone(kWidth, kHeight, 0, 15, options);
  alone.find(pictures.size, pictures.left, pictures.right, 1, found);
  EXPECT_TRUE(std::ranges::all_of(found, [](float d) { return std::isnan(d); }));
}

TEST_P(StartMethods, UnrelatedPicturesHaveHolesAndUnlitOnesNothingElse) {
  Pictures pictures = two_plates(1, -1);
  StartOptions options;
  options.method = GetParam();
  StartValue start(kWidth, kHeight, 0, 15, options);
  std::vector<float> found(pictures.size.slot_voxels());
  std::mt19937 random(7);
  std::shuffle(pictures.right.begin(), pictures.right.end(), random);
  start.find(pictures.size, pictures.left, pictures.right, 0, found);
  const auto holes = std::ranges::count_if(found, [](float d) { return std::isnan(d); });
  EXPECT_GT(holes, 0.3 * static_cast<double>(found.size()));  // the rest is weeded out by its correlation
  pictures = two_plates(1, -1);
  for (float& grey : pictures.left) {
    grey *= 0.1F;
  }
  start.find(pictures.size, pictures.left, pictures.right, 0, found);
  EXPECT_TRUE(std::ranges::all_of(found, [](float d) { return std::isnan(d); }));
}

INSTANTIATE_TEST_SUITE_P(Both, StartMethods,
                         ::testing::Values(StartMethod::ScanLines, StartMethod::SemiGlobal),
                         [](const auto& method) {
                           return method.param == StartMethod::ScanLines ? "ScanLines" : "SemiGlobal";
                         });

TEST(StartValue, NegativeDisparitiesAreLikeOthers) {
  Pictures pictures = two_plates(1, -1);
  std::swap(pictures.left, pictures.right);
  StartOptions options;
  options.window_t = 1;
  StartValue start(kWidth, kHeight, -15, 0, options);
  std::vector<float> found(pictures.size.slot_voxels());
  start.find(pictures.size, pictures.left, pictures.right, 0, found);
  EXPECT_NEAR(found[pictures.size.voxel(20, 12, 0)], -kFar_px, 0.5);
  EXPECT_NEAR(found[pictures.size.voxel(70, 12, 0)], -kNear_px, 0.5);
}

// Only the box around what is lit is looked at: what surrounds it prefers nothing.
TEST(StartValue, OfALitPatchAreTheSameInALargerPicture) {
  const Pictures pictures = two_plates(1, -1);
  constexpr int kMargin = 24;
  const VolumeSize size{kWidth + 2 * kMargin, kHeight + 2 * kMargin, 1};
  std::vector<float> left(size.voxels(), 0.0F);
  std::vector<float> right = left;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      left[size.voxel(x + kMargin, y + kMargin, 0)] = pictures.left[pictures.size.voxel(x, y, 0)];
      right[size.voxel(x + kMargin, y + kMargin, 0)] = pictures.right[pictures.size.voxel(x, y, 0)];
    }
  }
  StartOptions options;
  options.window_t = 1;
  StartValue alone(kWidth, kHeight, 0, 15, options);
  std::vector<float> found(pictures.size.slot_voxels());
  alone.find(pictures.size, pictures.left, pictures.right, 0, found);
  StartValue start(size.width_px, size.height_px, 0, 15, options);
  std::vector<float> within(size.slot_voxels());
  start.find(size, left, right, 0, within);
  int compared = 0;
  for (int y = 0; y < size.height_px; ++y) {
    for (int x = 0; x < size.width_px; ++x) {
      const float d = within[size.voxel(x, y, 0)];
      const bool lit = x >= kMargin && x < kMargin + kWidth && y >= kMargin && y < kMargin + kHeight;
      if (!lit) {
        EXPECT_TRUE(std::isnan(d)) << x << " " << y;
        continue;
      }
      const float other = found[pictures.size.voxel(x - kMargin, y - kMargin, 0)];
      // The first and last column have one neighbour fewer where the picture ends.
      if (x > kMargin + 15 && x < kMargin + kWidth - 1 && !std::isnan(other)) {
        EXPECT_NEAR(d, other, 0.2F) << x << " " << y;
        ++compared;
      }
    }
  }
  EXPECT_GT(compared, kWidth * kHeight / 2);
}

TEST(StartValue, RefusesWhatMakesNoSense) {
  EXPECT_THROW(StartValue(64, 48, 5, 4, {}), Error);
  EXPECT_THROW(StartValue(64, 48, 0, 64, {}), Error);
  StartOptions options;
  options.path_count = 5;
  EXPECT_THROW(StartValue(64, 48, 0, 16, options), Error);
}

}  // namespace
}  // namespace facet::stereo
