#include "refine/patches.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <set>
#include <span>
#include <vector>

#include "facet/error.hpp"
#include "problems.hpp"

namespace facet::refine {
namespace {

class PatchesTest : public testing::Test {
 protected:
  std::span<const std::int32_t> ring(std::int32_t vertex) const {
    const auto v = static_cast<std::size_t>(vertex);
    return std::span(rings.neighbours)
        .subspan(static_cast<std::size_t>(rings.offsets[v]),
                 static_cast<std::size_t>(rings.offsets[v + 1] - rings.offsets[v]));
  }

  PatchLists cut(std::uint32_t most, std::uint32_t most_places = 0) const {
    return cut_patches(rings, free, small.curve(), most, most_places);
  }

  /// Vertices of the first `count` of a patch's records.
  static std::vector<std::int32_t> vertices(const PatchLists& lists, const PatchLists::Row& patch,
                                            int count) {
    std::vector<std::int32_t> out;
    for (int k = 0; k < count; ++k) {
      out.push_back(lists.records[static_cast<std::size_t>(patch[0] + k)][0]);
    }
    return out;
  }
  static std::set<std::int32_t> own_of(const PatchLists& lists, const PatchLists::Row& patch) {
    const std::vector<std::int32_t> own = vertices(lists, patch, patch[1]);
    return {own.begin(), own.end()};
  }

  test::SmallProblem small = test::make_problem(30, 30, 7, 1);
  const mesh::OneRings& rings = *small.problem.rings;
  std::vector<std::uint8_t> free = small.free();
};

TEST_F(PatchesTest, EveryFreeVertexIsOnePatchsOwnInEachSet) {
  const PatchLists lists = cut(200);
  for (const PatchLists::Set& set : lists.sets) {
    ASSERT_GT(set.count, 4U);
    std::vector<int> owned(free.size(), 0);
    for (std::uint32_t p = 0; p < set.count; ++p) {
      const PatchLists::Row& patch = lists.patches[set.first + p];
      EXPECT_LE(patch[1], 200);
      for (const std::int32_t v : vertices(lists, patch, patch[1])) {
        ++owned[static_cast<std::size_t>(v)];
      }
    }
    for (std::size_t v = 0; v < free.size(); ++v) {
      EXPECT_EQ(owned[v], free[v]) << "vertex " << v;
    }
  }
}

TEST_F(PatchesTest, TheHaloIsTwoFreeRingsAndOneOfAnyKind) {
  const PatchLists lists = cut(200);
  for (const PatchLists::Row& patch : lists.patches) {
    std::set<std::int32_t> solved = own_of(lists, patch);
    for (int halo = 0; halo < 2; ++halo) {
      const std::set<std::int32_t> inside = solved;
      for (const std::int32_t v : inside) {
        for (const std::int32_t j : ring(v)) {
          if (free[static_cast<std::size_t>(j)] != 0) {
            solved.insert(j);
          }
        }
      }
    }
    std::set<std::int32_t> all = solved;
    for (const std::int32_t v : solved) {
      all.insert(ring(v).begin(), ring(v).end());
    }
    const std::vector<std::int32_t> found_solved = vertices(lists, patch, patch[2]);
    const std::vector<std::int32_t> found_all = vertices(lists, patch, patch[3]);
    EXPECT_EQ(std::set(found_solved.begin(), found_solved.end()), solved);
    EXPECT_EQ(std::set(found_all.begin(), found_all.end()), all);
    EXPECT_EQ(found_all.size(), all.size());
  }
}

TEST_F(PatchesTest, GroupsNameTheRingByPlacesOfThePatch) {
  const PatchLists lists = cut(200);
  for (const PatchLists::Set& set : lists.sets) {
    for (std::uint32_t p = 0; p < set.count; ++p) {
      const PatchLists::Row& patch = lists.patches[set.first + p];
      for (int k = 0; k < patch[3]; ++k) {
        const PatchLists::Row& record = lists.records[static_cast<std::size_t>(patch[0] + k)];
        const std::span<const std::int32_t> neighbours = ring(record[0]);
        ASSERT_EQ(static_cast<std::size_t>(record[3]), neighbours.size());
        for (std::size_t n = 0; n < (neighbours.size() + 3) / 4 * 4; ++n) {
          const std::int32_t place = lists.groups[static_cast<std::size_t>(record[2]) + n / 4][n % 4];
          ASSERT_LE(place, patch[3]);
          if (n >= neighbours.size()) {
            EXPECT_EQ(place, 0);
          } else if (place == 0) {
            EXPECT_GE(k, patch[2]) << "what is solved needs its whole ring";
          } else {
            const std::int32_t at = patch[0] + place - 1;
            EXPECT_EQ(lists.records[static_cast<std::size_t>(at)][0], neighbours[n]);
          }
        }
      }
    }
  }
}

TEST_F(PatchesTest, TheSecondSetsBordersLieElsewhere) {
  const PatchLists lists = cut(200);
  std::set<std::set<std::int32_t>> first;
  for (std::uint32_t p = 0; p < lists.sets[0].count; ++p) {
    first.insert(own_of(lists, lists.patches[lists.sets[0].first + p]));
  }
  for (std::uint32_t p = 0; p < lists.sets[1].count; ++p) {
    EXPECT_FALSE(first.contains(own_of(lists, lists.patches[lists.sets[1].first + p])));
  }
}

TEST_F(PatchesTest, AFewVerticesAreOnePatch) {
  const PatchLists lists = cut(1'000'000);
  EXPECT_EQ(lists.sets[0].count, 1U);
  EXPECT_EQ(lists.patches[0][1], std::ranges::count(free, 1));
  EXPECT_EQ(lists.patches[0][1], lists.patches[0][2]);
}

TEST_F(PatchesTest, PatchesAreCutSmallerUntilTheyFit) {
  const PatchLists any = cut(1000);
  const PatchLists fitting = cut(1000, 900);
  EXPECT_GE(std::ranges::max(any.patches, {}, [](const auto& patch) { return patch[3]; })[3], 900);
  for (const PatchLists::Row& patch : fitting.patches) {
    EXPECT_LT(patch[3], 900);
  }
  EXPECT_GT(fitting.sets[0].count, any.sets[0].count);
  EXPECT_THROW(cut(1000, 20), Error);
}

TEST_F(PatchesTest, PlacesAreEnoughForASetWithOneMoreAPatch) {
  const PatchLists lists = cut(200);
  for (const PatchLists::Set& set : lists.sets) {
    std::uint32_t places = 0;
    for (std::uint32_t p = 0; p < set.count; ++p) {
      // As the kernel finds a patch's first place.
      const PatchLists::Row& patch = lists.patches[set.first + p];
      EXPECT_EQ(static_cast<std::uint32_t>(patch[0] - set.first_record) + p, places);
      places += static_cast<std::uint32_t>(patch[3]) + 1;
    }
    EXPECT_LE(places, lists.place_count);
  }
}

TEST_F(PatchesTest, NothingFreeIsAnEmptyPatch) {
  free.assign(free.size(), 0);
  const PatchLists lists = cut(100);
  EXPECT_EQ(lists.sets[0].count, 1U);
  EXPECT_EQ(lists.patches[0][3], 0);
}

}  // namespace
}  // namespace facet::refine
