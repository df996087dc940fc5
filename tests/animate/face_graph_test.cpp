// Face graphs: [SF04 eq. 23] through the reduced basis, paths, walks.

#include "animate/face_graph.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "support/take_actor.hpp"

namespace facet::animate {
namespace {

class FaceGraphTest : public ::testing::Test {
 protected:
  std::shared_ptr<const TakeBasis> open(std::uint64_t seed, int frames) const {
    return TakeBasis::open(test::record_actor(folder_.path(), seed, frames));
  }
  test::TemporaryFolder folder_;
};

TEST_F(FaceGraphTest, DistancesAreThoseOfTheMeshes) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const auto basis = open(seed, 60);
    const FaceGraph graph(*basis, RegionMetric(*basis));
    take::TakeReader reader(basis->take());
    const auto direct = [&](std::int32_t a, std::int32_t b) {
      const auto first = reader.frame(a);
      const auto second = reader.frame(b);
      double squares = 0;
      for (std::size_t v = 0; v < first->displacements_mm.size(); ++v) {
        const double apart = static_cast<double>(first->displacements_mm[v] - second->displacements_mm[v]);
        squares += apart * apart;
      }
      const auto coarse =
          static_cast<double>((first->control_vertices_mm - second->control_vertices_mm).squaredNorm());
      return std::sqrt(coarse / basis->control_count() + squares / basis->finest_count());
    };
    for (const auto& [a, b] : {std::pair(3, 40), std::pair(10, 59), std::pair(31, 32)}) {
      EXPECT_NEAR(graph.distance(a, b), direct(a, b), 0.01) << "seed " << seed;
      const double expected = a + 1 == b ? 0.3 * direct(a, b) : direct(a + 1, b) + 0.3 * direct(a, b);
      if (basis->frames()[static_cast<std::size_t>(a) + 1].blink +
              basis->frames()[static_cast<std::size_t>(b)].blink ==
          0) {
        EXPECT_NEAR(graph.cost(a, b), expected, 0.02) << "seed " << seed;
      }
      EXPECT_GE(graph.cost(a, b), expected - 0.02) << "seed " << seed;
    }
  }
}

TEST_F(FaceGraphTest, EdgesAreTheSuccessorAndCheapJumps) {
  const auto basis = open(1, 150);
  const FaceGraph graph(*basis, RegionMetric(*basis));
  for (std::int32_t face = 0; face < graph.face_count(); ++face) {
    const auto edges = graph.edges(face);
    ASSERT_FALSE(edges.empty());
    EXPECT_EQ(graph.successor(face), face < 149 ? face + 1 : -1);
    if (face < 149) {
      EXPECT_EQ(edges.front().to, face + 1);
    }
    for (const FaceGraph::Edge& edge : edges) {
      EXPECT_FLOAT_EQ(edge.cost, graph.cost(face, edge.to));
    }
    // None of its neighbourhood in time is cheaper than the cheapest kept one, blinks aside.
    const std::int32_t next = face < 149 ? face + 1 : face;
    const std::size_t first_jump = face < 149 ? 1 : 0;
    ASSERT_GT(edges.size(), first_jump);
    const auto frames = basis->frames();
    const auto blinks = [&](std::int32_t which) { return frames[static_cast<std::size_t>(which)].blink > 0; };
    for (std::int32_t to = 1; to + 1 < graph.face_count(); ++to) {
      const bool open = !blinks(next) && !blinks(to - 1) && !blinks(to) && !blinks(to + 1);
      const float cost = graph.cost(face, to);
      if (open && std::abs(to - next) > 10 && cost < graph.cost(face, to - 1) &&
          cost < graph.cost(face, to + 1)) {
        EXPECT_LE(edges[first_jump].cost, cost + 1e-3F) << face << " to " << to;
      }
    }
  }
}

TEST_F(FaceGraphTest, PathsAreTheCheapestAndNeverDearerThanLinearInterpolation) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    const auto basis = open(seed, 120);
    const FaceGraph graph(*basis, RegionMetric(*basis));
    int with_steps = 0;
    for (const auto& [from, to] :
         {std::pair(5, 100), std::pair(100, 5), std::pair(60, 20), std::pair(0, 119), std::pair(30, 31)}) {
      const FaceGraph::Path path = graph.shortest(from, to);
      EXPECT_EQ(path.faces.front(), from);
      EXPECT_EQ(path.faces.back(), to);
      EXPECT_LE(path.cost, path.direct_cost + 1e-6) << "seed " << seed << ": " << from << " to " << to;
      with_steps += path.faces.size() > 2 ? 1 : 0;
      double cost = 0;
      for (std::size_t k = 0; k + 1 < path.faces.size(); ++k) {
        cost += static_cast<double>(graph.cost(path.faces[k], path.faces[k + 1]));
      }
      EXPECT_NEAR(cost, path.cost, 1e-4);
    }
    EXPECT_GT(with_steps, 1) << "seed " << seed;
    EXPECT_EQ(graph.shortest(7, 7).faces, std::vector<std::int32_t>{7});
    EXPECT_EQ(graph.shortest(7, 7).cost, 0);
  }
}

TEST_F(FaceGraphTest, ShortestPathsAgreeWithRelaxingEveryEdge) {
  // No blinks in this take: costs are those of the edges alone [Bel58].
  const simulation::ActorTake actor = test::small_actor(6, 80);
  test::record_frames(folder_.path() / "open.take", 80, [&](int index) {
    auto frame = std::make_shared<mesh::MeshFrame>(*actor.frame(index));
    frame->expression[1] = frame->expression[2] = 0;
    return frame;
  });
  const auto basis = TakeBasis::open(folder_.path() / "open.take");
  const FaceGraph graph(*basis, RegionMetric(*basis));
  for (const auto& [from, to] : {std::pair(2, 70), std::pair(75, 10)}) {
    std::vector<double> least(80, 1e30);
    least[static_cast<std::size_t>(from)] = 0;
    for (int round = 0; round < 80; ++round) {
      for (std::int32_t face = 0; face < 80; ++face) {
        for (const FaceGraph::Edge& edge : graph.edges(face)) {
          double& there = least[static_cast<std::size_t>(edge.to)];
          there = std::min(there, least[static_cast<std::size_t>(face)] + static_cast<double>(edge.cost));
        }
      }
    }
    const double expected =
        std::min(least[static_cast<std::size_t>(to)], static_cast<double>(graph.cost(from, to)));
    EXPECT_NEAR(graph.shortest(from, to).cost, expected, 1e-4);
  }
}

TEST_F(FaceGraphTest, PacedPathsTakeTheirTime) {
  const auto basis = open(2, 150);
  const FaceGraph graph(*basis, RegionMetric(*basis));
  for (const int steps : {1, 2, 17, 90, 400}) {
    const FaceGraph::Path path = graph.paced(20, 90, steps, 5);
    EXPECT_EQ(path.faces.size(), static_cast<std::size_t>(steps) + 1);
    EXPECT_EQ(path.faces.front(), 20);
    EXPECT_EQ(path.faces.back(), 90);
  }
  // The take itself goes there in 70 steps.
  double straight = 0;
  for (std::int32_t face = 20; face < 90; ++face) {
    straight += static_cast<double>(graph.cost(face, face + 1));
  }
  EXPECT_LE(graph.paced(20, 90, 70, 0).cost, straight + 1e-3);
}

TEST_F(FaceGraphTest, WalksFollowTheEdgesAndDependOnTheSeed) {
  const auto basis = open(3, 240);
  const FaceGraph graph(*basis, RegionMetric(*basis));
  constexpr std::size_t kFaces = 4000;
  const auto walk = graph.random_walk(10, kFaces, 7, 60, 8);
  ASSERT_EQ(walk.size(), kFaces);
  EXPECT_EQ(walk, graph.random_walk(10, kFaces, 7, 60, 8));
  EXPECT_NE(walk, graph.random_walk(10, kFaces, 8, 60, 8));
  int jumps = 0;
  std::size_t run = 1;
  for (std::size_t k = 0; k + 1 < walk.size(); ++k) {
    const auto edges = graph.edges(walk[k]);
    const bool is_edge =
        std::any_of(edges.begin(), edges.end(), [&](const auto& edge) { return edge.to == walk[k + 1]; });
    ASSERT_TRUE(is_edge) << walk[k] << " to " << walk[k + 1];
    if (walk[k + 1] != graph.successor(walk[k])) {
      EXPECT_TRUE(run >= 8 || graph.successor(walk[k]) < 0);
      ++jumps;
      run = 1;
    } else {
      ++run;
    }
  }
  const double mean_run = static_cast<double>(kFaces) / jumps;
  EXPECT_GT(mean_run, 20);
  EXPECT_LT(mean_run, 180);
}

TEST_F(FaceGraphTest, GapsInTheTakeAreNoSteps) {
  const simulation::ActorTake actor = test::small_actor(2, 60);
  test::record_frames(folder_.path() / "gap.take", 60, [&](int index) {
    auto frame = std::make_shared<mesh::MeshFrame>(*actor.frame(index));
    frame->media_time_ns += index >= 30 ? 5'000'000'000 : 0;
    return frame;
  });
  const auto basis = TakeBasis::open(folder_.path() / "gap.take");
  const FaceGraph graph(*basis, RegionMetric(*basis));
  EXPECT_EQ(graph.successor(28), 29);
  EXPECT_EQ(graph.successor(29), -1);
  EXPECT_EQ(graph.successor(59), -1);
  EXPECT_EQ(graph.random_walk(29, 300, 1, 30, 8).size(), 300U);
}

}  // namespace
}  // namespace facet::animate
