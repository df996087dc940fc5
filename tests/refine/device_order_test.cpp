#include "refine/device_order.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "problems.hpp"

namespace facet::refine {
namespace {

/// Mean distance of a vertex from its neighbours in memory, in vertices.
double mean_reach(const mesh::OneRings& rings) {
  double sum = 0;
  for (std::size_t v = 0; v + 1 < rings.offsets.size(); ++v) {
    for (auto k = static_cast<std::size_t>(rings.offsets[v]);
         k < static_cast<std::size_t>(rings.offsets[v + 1]); ++k) {
      sum += std::abs(static_cast<double>(rings.neighbours[k]) - static_cast<double>(v));
    }
  }
  return sum / static_cast<double>(rings.neighbours.size());
}

class DeviceOrderTest : public testing::Test {
 protected:
  test::SmallProblem small = test::make_problem(40, 40, 5, 1);
  const mesh::Hierarchy& hierarchy = *small.hierarchy;
  const mesh::Level& fine = hierarchy.levels[1];
  DeviceOrder order = device_order(fine.one_rings, hierarchy.texture_coordinates);
};

TEST_F(DeviceOrderTest, IsAPermutation) {
  ASSERT_EQ(order.host_index.size(), static_cast<std::size_t>(fine.vertex_count));
  std::vector<int> seen(order.host_index.size(), 0);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const auto host = static_cast<std::size_t>(order.host_index[i]);
    ++seen[host];
    EXPECT_EQ(static_cast<std::size_t>(order.device_index[host]), i);
  }
  EXPECT_TRUE(std::ranges::all_of(seen, [](int times) { return times == 1; }));
}

TEST_F(DeviceOrderTest, RingsAreTheSameRingsByOtherNames) {
  const mesh::OneRings rings = reordered(fine.one_rings, order);
  ASSERT_EQ(rings.offsets.size(), fine.one_rings.offsets.size());
  for (std::size_t i = 0; i < order.host_index.size(); ++i) {
    const auto host = static_cast<std::size_t>(order.host_index[i]);
    const auto first = static_cast<std::size_t>(fine.one_rings.offsets[host]);
    const auto size = static_cast<std::size_t>(fine.one_rings.offsets[host + 1]) - first;
    ASSERT_EQ(static_cast<std::size_t>(rings.offsets[i + 1] - rings.offsets[i]), size);
    EXPECT_EQ(rings.on_boundary[i], fine.one_rings.on_boundary[host]);
    for (std::size_t k = 0; k < size; ++k) {
      const auto neighbour =
          static_cast<std::size_t>(rings.neighbours[static_cast<std::size_t>(rings.offsets[i]) + k]);
      EXPECT_EQ(order.host_index[neighbour], fine.one_rings.neighbours[first + k]);
    }
  }
}

TEST_F(DeviceOrderTest, StencilsGiveTheSameValuesByOtherNames) {
  const DeviceOrder coarser = device_order(hierarchy.levels[0].one_rings, hierarchy.texture_coordinates);
  Eigen::MatrixXf values = Eigen::MatrixXf::Random(2, hierarchy.levels[0].vertex_count);
  Eigen::MatrixXf expected;
  mesh::apply(fine.from_coarser, values, expected);
  Eigen::MatrixXf moved(values.rows(), values.cols());
  for (Eigen::Index i = 0; i < values.cols(); ++i) {
    moved.col(i) = values.col(coarser.host_index[static_cast<std::size_t>(i)]);
  }
  Eigen::MatrixXf found;
  mesh::apply(reordered(fine.from_coarser, order, &coarser), moved, found);
  for (Eigen::Index i = 0; i < found.cols(); ++i) {
    EXPECT_EQ(found.col(i), expected.col(order.host_index[static_cast<std::size_t>(i)]));
  }
}

TEST_F(DeviceOrderTest, NeighboursLieNearerThanInTheHierarchy) {
  EXPECT_LT(mean_reach(reordered(fine.one_rings, order)), 0.25 * mean_reach(fine.one_rings));
}

TEST_F(DeviceOrderTest, WithinATileLikeRingsStandTogether) {
  constexpr std::size_t kTile = 1024;
  const mesh::OneRings rings = reordered(fine.one_rings, order);
  std::size_t changes = 0;
  for (std::size_t i = 1; i < order.host_index.size(); ++i) {
    const auto groups = [&](std::size_t v) { return (rings.offsets[v + 1] - rings.offsets[v] + 3) / 4; };
    changes += i % kTile != 0 && groups(i) != groups(i - 1) ? 1 : 0;
  }
  EXPECT_LE(changes, (order.host_index.size() / kTile + 1) * 2);
}

}  // namespace
}  // namespace facet::refine
