#include "stereo/unknowns.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <random>

#include "facet/error.hpp"

namespace facet::stereo {
namespace {

using namespace shaders::stereo;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kBreak_px = 1.5F;

/// Random surfaces with holes, of which the second third of the rows is one.
std::vector<float> make_start(const VolumeSize& size) {
  std::mt19937 random(61);
  std::uniform_real_distribution<float> uniform(0, 1);
  std::vector<float> out(size.voxels());
  for (std::size_t voxel = 0; voxel < out.size(); ++voxel) {
    const auto y = static_cast<int>(voxel / static_cast<std::size_t>(size.width_px)) % size.height_px;
    const bool hole = uniform(random) < 0.3F || (3 * y >= size.height_px && 3 * y < 2 * size.height_px);
    out[voxel] = hole ? kNan : 3 * uniform(random);
  }
  return out;
}

TEST(Unknowns, AreLinkedWithinTheBreakAndKnowTheirNeighbours) {
  const VolumeSize size{13, 17, 4};
  const std::vector<float> start = make_start(size);
  Unknowns unknowns(size, 4, 2, 2, 5);
  unknowns.find(start, kBreak_px, 1000);
  std::vector<int> index(size.voxels(), -1);
  std::size_t known = 0;
  for (std::size_t i = 0; i < unknowns.count(); ++i) {
    index[unknowns.voxels()[i]] = static_cast<int>(i);
  }
  const std::array<int, 3> extent{size.width_px, size.height_px, size.slots};
  const auto value = [&](std::array<int, 3> at) { return start[size.voxel(at[0], at[1], at[2])]; };
  const auto linked = [&](std::array<int, 3> at, std::size_t axis, int first, int second) {
    std::array<int, 3> a = at;
    std::array<int, 3> b = at;
    a.at(axis) += first;
    b.at(axis) += second;
    return a.at(axis) >= 0 && b.at(axis) >= 0 && a.at(axis) < extent.at(axis) &&
           b.at(axis) < extent.at(axis) && std::abs(value(a) - value(b)) <= kBreak_px;
  };
  for (int t = 0; t < size.slots; ++t) {
    for (int y = 0; y < size.height_px; ++y) {
      for (int x = 0; x < size.width_px; ++x) {
        const std::array<int, 3> at{x, y, t};
        const int i = index[size.voxel(x, y, t)];
        ASSERT_EQ(i >= 0, !std::isnan(value(at)));
        if (i < 0) {
          continue;
        }
        ++known;
        const shaders::ivec4 entry = unknowns.list()[static_cast<std::size_t>(i)];
        EXPECT_EQ(static_cast<std::uint32_t>(entry.x),
                  static_cast<std::uint32_t>(x) + kMost_px * static_cast<std::uint32_t>(y) +
                      kMost_px * kMost_px * static_cast<std::uint32_t>(t));
        const auto before_steps = static_cast<std::uint32_t>(entry.z);
        const auto after_steps = static_cast<std::uint32_t>(entry.w);
        constexpr std::uint32_t kAlongY = (1U << kAlongYBits) - 1;
        const std::array<std::uint32_t, 3> before{static_cast<std::uint32_t>(entry.y) & 1U,
                                                  before_steps & kAlongY, before_steps >> kAlongYBits};
        const std::array<std::uint32_t, 3> after{static_cast<std::uint32_t>(entry.y) >> 1U & 1U,
                                                 after_steps & kAlongY, after_steps >> kAlongYBits};
        for (std::size_t axis = 0; axis < 3; ++axis) {
          const std::uint32_t bits = static_cast<std::uint32_t>(entry.y) >> (4 * axis) & 15U;
          std::uint32_t expected = 0;
          const auto neighbour = [&](int step) {
            std::array<int, 3> there = at;
            there.at(axis) += step;
            return index[size.voxel(there[0], there[1], there[2])];
          };
          if (linked(at, axis, -1, 0)) {
            expected |= kLinkBefore | (linked(at, axis, -2, -1) ? kBeforeHasBefore : 0U);
            EXPECT_EQ(i - static_cast<int>(before.at(axis)), neighbour(-1));
          }
          if (linked(at, axis, 0, 1)) {
            expected |= kLinkAfter | (linked(at, axis, 1, 2) ? kAfterHasAfter : 0U);
            EXPECT_EQ(i + static_cast<int>(after.at(axis)), neighbour(1));
          }
          EXPECT_EQ(bits, expected);
          EXPECT_TRUE((bits & kLinkBefore) != 0 || before.at(axis) == 0);
          EXPECT_TRUE((bits & kLinkAfter) != 0 || after.at(axis) == 0);
        }
      }
    }
  }
  EXPECT_EQ(known, unknowns.count());
}

TEST(Unknowns, BandsHoldTheirUnknownsAndPartsTheirBands) {
  const VolumeSize size{13, 17, 4};
  const std::vector<float> start = make_start(size);
  for (const std::size_t most_cells : {std::size_t{1}, std::size_t{400}, std::size_t{100'000}}) {
    Unknowns unknowns(size, 4, 2, 1, 3);
    unknowns.find(start, kBreak_px, most_cells);
    ASSERT_EQ(unknowns.bands().size(), 6U);
    std::int32_t next = 0;
    int part = 0;
    std::size_t in_part = 0;
    std::size_t bands_in_part = 0;
    for (const Band& band : unknowns.bands()) {
      EXPECT_EQ(band.places.x, next);
      next = band.places.y;
      EXPECT_GE(band.origin.w, part);
      if (band.origin.w > part) {
        part = band.origin.w;
        in_part = 0;
        bands_in_part = 0;
      }
      for (std::int32_t i = band.places.x; i < band.places.y; ++i) {
        const auto packed = static_cast<std::uint32_t>(unknowns.list()[static_cast<std::size_t>(i)].x);
        const auto x = static_cast<int>(packed % kMost_px);
        const auto y = static_cast<int>(packed / kMost_px % kMost_px);
        const auto t = static_cast<int>(packed / kMost_px / kMost_px);
        EXPECT_TRUE(x >= band.origin.x && x < band.origin.x + band.extent.x);
        EXPECT_TRUE(y >= band.origin.y && y < band.origin.y + band.extent.y);
        EXPECT_TRUE(std::max(0, t - 1) >= band.origin.z);
        EXPECT_TRUE(std::min(size.slots - 1, t + 1) < band.origin.z + band.extent.z);
      }
      if (band.places.x < band.places.y) {
        EXPECT_EQ(static_cast<std::size_t>(band.places.w), in_part);
        in_part += static_cast<std::size_t>(band.extent.x) * static_cast<std::size_t>(band.extent.y) *
                   static_cast<std::size_t>(band.extent.z);
        ++bands_in_part;
        EXPECT_TRUE(in_part <= most_cells || bands_in_part == 1);
        EXPECT_LE(in_part, unknowns.most_sums_xy());
      }
    }
    EXPECT_EQ(static_cast<std::size_t>(next), unknowns.count());
    EXPECT_EQ(part + 1, unknowns.part_count());
    EXPECT_EQ(most_cells<1000, unknowns.part_count()> 1);
  }
}

TEST(Unknowns, NoneAreNone) {
  const VolumeSize size{9, 7, 2};
  Unknowns unknowns(size, 4, 2, 2, 4);
  unknowns.find(std::vector<float>(size.voxels(), kNan), kBreak_px, 100);
  EXPECT_EQ(unknowns.count(), 0U);
  EXPECT_EQ(unknowns.part_count(), 1);
  EXPECT_EQ(unknowns.most_sums_xy(), 0U);
}

TEST(Unknowns, RefuseWhatTheirWordsCannotHold) {
  EXPECT_THROW(Unknowns({4097, 2, 1}, 4, 2, 2, 8), Error);
  EXPECT_THROW(Unknowns({2, 4097, 1}, 4, 2, 2, 8), Error);
  EXPECT_THROW(Unknowns({2, 2, 257}, 4, 2, 2, 8), Error);
  EXPECT_THROW(Unknowns({4096, 2, 128}, 4, 2, 2, 8), Error);
}

}  // namespace
}  // namespace facet::stereo
