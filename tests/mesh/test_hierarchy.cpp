#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <set>
#include <string>
#include <utility>

#include "facet/error.hpp"
#include "mesh/hierarchy.hpp"
#include "surfaces.hpp"

namespace facet::mesh {
namespace {

using test::Surface;
using ::testing::HasSubstr;

std::shared_ptr<const Hierarchy> build(const Surface& surface, const HierarchyOptions& options) {
  return build_hierarchy(surface.control, surface.projected_px, surface.facing, options);
}

std::vector<Vertices> positions(const Hierarchy& hierarchy, const Vertices& control) {
  std::vector<Vertices> levels;
  push_positions(hierarchy, control, levels);
  return levels;
}

std::int32_t valence(const Level& level, std::int32_t vertex) {
  const auto v = static_cast<std::size_t>(vertex);
  return level.one_rings.offsets[v + 1] - level.one_rings.offsets[v];
}

/// Which faces hold each undirected edge.
std::map<std::pair<std::int32_t, std::int32_t>, std::vector<Eigen::Index>> faces_by_edge(const Level& level) {
  std::map<std::pair<std::int32_t, std::int32_t>, std::vector<Eigen::Index>> faces;
  for (Eigen::Index f = 0; f < level.triangles.cols(); ++f) {
    for (Eigen::Index corner = 0; corner < 3; ++corner) {
      faces[std::minmax(level.triangles(corner, f), level.triangles((corner + 1) % 3, f))].push_back(f);
    }
  }
  return faces;
}

std::int64_t euler_characteristic(const Level& level) {
  return level.vertex_count - static_cast<std::int64_t>(faces_by_edge(level).size()) + level.triangles.cols();
}

/// Every edge has one or two faces; those with one are the boundary that the one-rings name: no crack and
/// no T-junction, which would show as extra boundary.
void expect_conforming(const Hierarchy& hierarchy, std::int64_t characteristic, std::size_t boundary_loops) {
  for (const Level& level : hierarchy.levels) {
    EXPECT_EQ(euler_characteristic(level), characteristic);
    std::map<std::int32_t, std::vector<std::int32_t>> boundary;
    for (const auto& [edge, faces] : faces_by_edge(level)) {
      ASSERT_LE(faces.size(), 2U);
      if (faces.size() == 1) {
        boundary[edge.first].push_back(edge.second);
        boundary[edge.second].push_back(edge.first);
      }
    }
    std::size_t loops = 0;
    while (!boundary.empty()) {
      ++loops;
      std::vector<std::int32_t> open{boundary.begin()->first};
      while (!open.empty()) {
        const auto node = boundary.extract(open.back());
        open.pop_back();
        if (!node.empty()) {
          ASSERT_EQ(node.mapped().size(), 2U);
          open.insert(open.end(), node.mapped().begin(), node.mapped().end());
        }
      }
    }
    EXPECT_EQ(loops, boundary_loops);
  }
}

/// Area and orientation of every face in the plane of the texture coordinates.
float doubled_area(const TextureCoordinates& at, const Triangles& triangles, Eigen::Index face) {
  const Eigen::Vector2f a = at.col(triangles(0, face));
  const Eigen::Vector2f b = at.col(triangles(1, face)) - a;
  const Eigen::Vector2f c = at.col(triangles(2, face)) - a;
  return b.x() * c.y() - b.y() * c.x();
}

std::string error_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

TEST(Hierarchy, StaysConformingAndOrientedWhereOnlyAPartIsRefined) {
  Surface surface = test::plane(9, 7, 8.0F);
  // A round island may be refined; the rest only as conformity needs.
  for (Eigen::Index v = 0; v < surface.vertices_mm.cols(); ++v) {
    const bool inside = (surface.vertices_mm.col(v).head<2>() - Eigen::Vector2f(30, 25)).norm() < 18;
    surface.control.refinable[static_cast<std::size_t>(v)] = inside ? 1 : 0;
  }
  const auto hierarchy = build(surface, {.min_edge_px = 0.7F, .max_levels = 5, .max_vertices = 1'000'000});
  ASSERT_EQ(hierarchy->levels.size(), 5U);
  expect_conforming(*hierarchy, 1, 1);
  const auto levels = positions(*hierarchy, surface.vertices_mm);
  for (std::size_t l = 0; l < levels.size(); ++l) {
    float area = 0;
    for (Eigen::Index f = 0; f < hierarchy->levels[l].triangles.cols(); ++f) {
      const float face = doubled_area(levels[l].topRows<2>(), hierarchy->levels[l].triangles, f);
      ASSERT_GT(face, 0) << "level " << l << " face " << f;
      area += face;
    }
    EXPECT_NEAR(area, 2 * 72 * 56, 0.5);
  }
  // Refinement fades out: far from the island the faces are those of level 0.
  const Level& finest = hierarchy->finest();
  const Vertices& at = levels.back();
  float largest = 0;
  float smallest = std::numeric_limits<float>::max();
  for (Eigen::Index f = 0; f < finest.triangles.cols(); ++f) {
    const float length = (at.col(finest.triangles(1, f)) - at.col(finest.triangles(2, f))).norm();
    largest = std::max(largest, length);
    smallest = std::min(smallest, length);
  }
  EXPECT_GT(largest, 7.9F);
  EXPECT_LT(smallest, 0.8F);
}

TEST(Hierarchy, ClosedSurfacesAndTubesKeepTheirShape) {
  expect_conforming(*build(test::sphere(4, 60), {.min_edge_px = 4}), 2, 0);
  expect_conforming(*build(test::tube(12, 5, 40, 80), {.min_edge_px = 4}), 0, 2);
}

TEST(Hierarchy, LevelZeroIsOneBisectionOfEveryQuad) {
  Surface surface = test::plane(6, 5, 1.0F);
  surface.control.refinable.assign(surface.control.refinable.size(), 0);
  const auto hierarchy = build(surface, {.min_edge_px = 0.01F});
  ASSERT_EQ(hierarchy->levels.size(), 1U);
  EXPECT_EQ(hierarchy->levels[0].vertex_count, surface.control.vertex_count + 30);
  EXPECT_EQ(hierarchy->levels[0].triangles.cols(), 120);
}

TEST(Hierarchy, ALevelDoublesTheResolution) {
  const Surface surface = test::plane(8, 8, 1.0F);
  const auto hierarchy = build(surface, {.min_edge_px = 0.001F, .max_levels = 3, .max_vertices = 1'000'000});
  ASSERT_EQ(hierarchy->levels.size(), 3U);
  EXPECT_EQ(hierarchy->levels[1].triangles.cols(), 4 * hierarchy->levels[0].triangles.cols());
  EXPECT_EQ(hierarchy->levels[2].triangles.cols(), 16 * hierarchy->levels[0].triangles.cols());
}

TEST(Hierarchy, ValencesAreFourAndEightInside) {
  const Surface surface = test::plane(8, 6, 1.0F);
  const auto hierarchy = build(surface, {.min_edge_px = 0.001F, .max_levels = 3, .max_vertices = 1'000'000});
  for (const Level& level : hierarchy->levels) {
    for (std::int32_t v = 0; v < level.vertex_count; ++v) {
      if (level.one_rings.on_boundary[static_cast<std::size_t>(v)] == 0) {
        EXPECT_TRUE(valence(level, v) == 4 || valence(level, v) == 8) << v;
      }
    }
    for (Eigen::Index f = 0; f < level.triangles.cols(); ++f) {
      if (level.one_rings.on_boundary[static_cast<std::size_t>(level.triangles(0, f))] == 0) {
        EXPECT_EQ(valence(level, level.triangles(0, f)), 4) << "an apex is the newest vertex of its face";
      }
    }
  }
}

TEST(Hierarchy, NeighboursAtAnInteriorEdgeAreMatesOrOneLevelCoarser) {
  Surface surface = test::plane(10, 10, 10.0F);
  for (std::size_t v = 0; v < surface.facing.size(); ++v) {
    surface.facing[v] = v % 11 < 6 ? 1 : 0;
  }
  const auto hierarchy = build(surface, {.min_edge_px = 1.0F, .max_levels = 4});
  const Level& finest = hierarchy->finest();
  // In the plane's parameters (UV of old vertices never move) a face's level follows from its area, which
  // every bisection halves; UVs are averaged by the masks, which keeps the inside of a plane as it is.
  const auto area = [&](Eigen::Index f) {
    return doubled_area(hierarchy->texture_coordinates, finest.triangles, f);
  };
  const auto edges = faces_by_edge(finest);
  std::size_t mates = 0;
  std::size_t coarser = 0;
  for (Eigen::Index f = 0; f < finest.triangles.cols(); ++f) {
    const auto& faces = edges.at(std::minmax(finest.triangles(1, f), finest.triangles(2, f)));
    if (faces.size() == 1) {
      continue;
    }
    const Eigen::Index other = faces[0] == f ? faces[1] : faces[0];
    const bool is_mate = std::minmax(finest.triangles(1, other), finest.triangles(2, other)) ==
                         std::minmax(finest.triangles(1, f), finest.triangles(2, f));
    const float ratio = area(other) / area(f);
    // Next to the refined part the masks shift vertices a little, so the ratio is not exactly 1 or 2.
    EXPECT_NEAR(ratio, is_mate ? 1.0F : 2.0F, 0.55F) << "face " << f;
    ++(is_mate ? mates : coarser);
  }
  EXPECT_GT(mates, 100U);
  EXPECT_GT(coarser, 5U);
}

TEST(Hierarchy, StencilRowsSumToOne) {
  const auto hierarchy = build(test::sphere(5, 80), {.min_edge_px = 3});
  ASSERT_GT(hierarchy->levels.size(), 2U);
  std::int32_t coarser_count = hierarchy->control_vertex_count;
  for (const Level& level : hierarchy->levels) {
    ASSERT_EQ(level.from_coarser.row_count(), level.vertex_count);
    for (std::int32_t row = 0; row < level.vertex_count; ++row) {
      float sum = 0;
      for (auto entry =
               static_cast<std::size_t>(level.from_coarser.row_offsets[static_cast<std::size_t>(row)]);
           entry <
           static_cast<std::size_t>(level.from_coarser.row_offsets[static_cast<std::size_t>(row) + 1]);
           ++entry) {
        EXPECT_GT(level.from_coarser.weights[entry], 0);
        EXPECT_LT(level.from_coarser.columns[entry], coarser_count);
        sum += level.from_coarser.weights[entry];
      }
      EXPECT_NEAR(sum, 1, 1e-6);
    }
    coarser_count = level.vertex_count;
  }
}

/// The face mask and the vertex mask, weight by weight, in the middle of a regular grid.
TEST(Hierarchy, MasksAreThoseOfVelhoAndZorin) {
  const Surface surface = test::plane(4, 4, 1.0F);
  const auto hierarchy = build(surface, {.max_levels = 1});
  const SparseRows& rows = hierarchy->levels[0].from_coarser;
  const auto row = [&](std::int32_t r) {
    std::map<std::int32_t, float> entries;
    for (auto e = static_cast<std::size_t>(rows.row_offsets[static_cast<std::size_t>(r)]);
         e < static_cast<std::size_t>(rows.row_offsets[static_cast<std::size_t>(r) + 1]); ++e) {
      entries[rows.columns[e]] = rows.weights[e];
    }
    return entries;
  };
  const std::int32_t centre = 12;
  EXPECT_EQ(row(centre), (std::map<std::int32_t, float>{
                             {7, 0.125F}, {11, 0.125F}, {12, 0.5F}, {13, 0.125F}, {17, 0.125F}}));
  const std::int32_t first_new = 25;
  EXPECT_EQ(row(first_new), (std::map<std::int32_t, float>{{0, 0.25F}, {1, 0.25F}, {5, 0.25F}, {6, 0.25F}}));
  const std::int32_t on_boundary = 2;
  EXPECT_EQ(row(on_boundary), (std::map<std::int32_t, float>{{2, 1.0F}}));
}

TEST(Hierarchy, IrregularVerticesShareHalfAmongTheirBlocks) {
  const Surface surface = test::sphere(3, 50);
  const auto hierarchy = build(surface, {.max_levels = 1});
  std::vector<std::set<std::int32_t>> joined(static_cast<std::size_t>(surface.control.vertex_count));
  for (Eigen::Index q = 0; q < surface.control.quads.cols(); ++q) {
    for (Eigen::Index corner = 0; corner < 4; ++corner) {
      const std::int32_t a = surface.control.quads(corner, q);
      const std::int32_t b = surface.control.quads((corner + 1) % 4, q);
      joined[static_cast<std::size_t>(a)].insert(b);
      joined[static_cast<std::size_t>(b)].insert(a);
    }
  }
  const SparseRows& rows = hierarchy->levels[0].from_coarser;
  std::size_t irregular = 0;
  for (std::size_t v = 0; v < joined.size(); ++v) {
    irregular += joined[v].size() == 3 ? 1 : 0;
    ASSERT_EQ(static_cast<std::size_t>(rows.row_offsets[v + 1] - rows.row_offsets[v]), joined[v].size() + 1);
    for (auto e = static_cast<std::size_t>(rows.row_offsets[v]);
         e < static_cast<std::size_t>(rows.row_offsets[v + 1]); ++e) {
      const bool own = rows.columns[e] == static_cast<std::int32_t>(v);
      EXPECT_TRUE(own || joined[v].count(rows.columns[e]) == 1);
      EXPECT_FLOAT_EQ(rows.weights[e], own ? 0.5F : 0.5F / static_cast<float>(joined[v].size()));
    }
  }
  EXPECT_EQ(irregular, 8U);
}

TEST(Hierarchy, RefinesAffinelyAndKeepsAPlanePlane) {
  const Surface surface = test::sphere(4, 60);
  const auto hierarchy = build(surface, {.min_edge_px = 5});
  Eigen::Matrix3f linear;
  linear << 1, 0.2F, -0.3F, 0.1F, 0.8F, 0.4F, 0.5F, -0.1F, 1.2F;
  const Eigen::Vector3f shift(3, -7, 11);
  const auto plain = positions(*hierarchy, surface.vertices_mm);
  const auto mapped = positions(*hierarchy, (linear * surface.vertices_mm).colwise() + shift);
  EXPECT_LT((((linear * plain.back()).colwise() + shift) - mapped.back()).cwiseAbs().maxCoeff(), 1e-3F);

  const Surface flat = test::plane(6, 6, 5);
  const auto flat_hierarchy = build(flat, {.min_edge_px = 1});
  Eigen::Matrix3f tilt = Eigen::Matrix3f::Identity();
  tilt(2, 0) = 0.7F;
  tilt(2, 1) = -0.2F;
  const auto tilted = positions(*flat_hierarchy, tilt * flat.vertices_mm);
  const Eigen::RowVectorXf off =
      tilted.back().row(2) - 0.7F * tilted.back().row(0) + 0.2F * tilted.back().row(1);
  EXPECT_LT(off.cwiseAbs().maxCoeff(), 1e-4F);
}

/// Regular inner regions reproduce affine maps of the grid: two rings from the boundary nothing moves.
TEST(Hierarchy, RegularInnerVerticesOfAPlaneStay) {
  const Surface surface = test::plane(8, 8, 4);
  const auto hierarchy = build(surface, {.min_edge_px = 0.5F, .max_levels = 3});
  const auto levels = positions(*hierarchy, surface.vertices_mm);
  for (Eigen::Index v = 0; v < surface.vertices_mm.cols(); ++v) {
    EXPECT_LT((levels.back().col(v) - surface.vertices_mm.col(v)).norm(), 1e-4F) << v;
  }
}

TEST(Hierarchy, KeepsTheBoundaryCurve) {
  const Surface surface = test::tube(10, 6, 30, 60);
  const auto hierarchy = build(surface, {.min_edge_px = 2});
  const Level& finest = hierarchy->finest();
  const auto levels = positions(*hierarchy, surface.vertices_mm);
  const std::int32_t around = 10;
  std::size_t on_boundary = 0;
  for (std::int32_t v = 0; v < finest.vertex_count; ++v) {
    if (finest.one_rings.on_boundary[static_cast<std::size_t>(v)] == 0) {
      continue;
    }
    ++on_boundary;
    const Eigen::Vector3f point = levels.back().col(v);
    // Distance to the two end polygons.
    float nearest = std::numeric_limits<float>::max();
    for (const std::int32_t first : {0, 6 * around}) {
      for (std::int32_t k = 0; k < around; ++k) {
        const Eigen::Vector3f a = surface.vertices_mm.col(first + k);
        const Eigen::Vector3f side = surface.vertices_mm.col(first + (k + 1) % around) - a;
        const float along = std::clamp((point - a).dot(side) / side.squaredNorm(), 0.0F, 1.0F);
        nearest = std::min(nearest, (point - a - along * side).norm());
      }
    }
    EXPECT_LT(nearest, 1e-4F);
    if (v < hierarchy->control_vertex_count) {
      EXPECT_EQ(point, surface.vertices_mm.col(v));
    }
  }
  EXPECT_GT(on_boundary, 40U);
}

/// What every level of a subdivided sphere looks like.
struct SphereFigures {
  float radius_spread_mm = 0;  ///< largest less smallest distance to the centre
  float roughness_rad = 0;     ///< largest angle between the normals of two faces at an edge
  float normal_error_rad = 0;  ///< largest angle of a vertex normal to the radius
};

std::vector<SphereFigures> subdivide_sphere(int cells, int max_levels) {
  Surface surface = test::sphere(cells, 50);
  surface.facing.assign(surface.facing.size(), 1);
  surface.projected_px *= 1000;  // all edges are long, but those seen end on
  const auto hierarchy =
      build(surface, {.min_edge_px = 1, .max_levels = max_levels, .max_vertices = 1'000'000});
  const auto levels = positions(*hierarchy, surface.vertices_mm);
  std::vector<SphereFigures> figures(levels.size());
  const auto angle = [](float cosine) { return std::acos(std::clamp(cosine, -1.0F, 1.0F)); };
  for (std::size_t l = 0; l < levels.size(); ++l) {
    const Triangles& triangles = hierarchy->levels[l].triangles;
    const Eigen::RowVectorXf radius = levels[l].colwise().norm();
    figures[l].radius_spread_mm = radius.maxCoeff() - radius.minCoeff();
    Eigen::Matrix3Xf face_normals(3, triangles.cols());
    for (Eigen::Index f = 0; f < triangles.cols(); ++f) {
      const Eigen::Vector3f a = levels[l].col(triangles(0, f));
      const Eigen::Vector3f b = levels[l].col(triangles(1, f));
      const Eigen::Vector3f c = levels[l].col(triangles(2, f));
      face_normals.col(f) = (b - a).cross(c - a).normalized();
    }
    for (const auto& [edge, faces] : faces_by_edge(hierarchy->levels[l])) {
      figures[l].roughness_rad = std::max(figures[l].roughness_rad,
                                          angle(face_normals.col(faces[0]).dot(face_normals.col(faces[1]))));
    }
    Eigen::Matrix3Xf normals;
    vertex_normals(levels[l], triangles, normals);
    figures[l].normal_error_rad =
        angle(normals.cwiseProduct(levels[l].colwise().normalized()).colwise().sum().minCoeff());
  }
  return figures;
}

/// Level by level the surface becomes smoother, and it tends to the sphere as the control mesh is refined.
TEST(Hierarchy, SmoothsASphere) {
  const auto coarse = subdivide_sphere(4, 3);
  const auto fine = subdivide_sphere(8, 3);
  ASSERT_EQ(coarse.size(), 3U);
  ASSERT_EQ(fine.size(), 3U);
  for (std::size_t l = 1; l < coarse.size(); ++l) {
    EXPECT_LT(coarse[l].roughness_rad, 0.75F * coarse[l - 1].roughness_rad) << "level " << l;
  }
  EXPECT_LT(fine.back().radius_spread_mm, 0.4F * coarse.back().radius_spread_mm);
  EXPECT_LT(fine.back().radius_spread_mm, 0.01F * 50);
  EXPECT_LT(fine.back().normal_error_rad, 0.7F * coarse.back().normal_error_rad);
}

/// No block that passes the test is left, and none was split that did not pass it or had to be.
TEST(Hierarchy, RespectsEpsilon) {
  const Surface surface = test::plane(6, 6, 10);
  for (const float epsilon : {0.9F, 2.0F, 3.3F, 6.0F}) {
    const auto hierarchy =
        build(surface, {.min_edge_px = epsilon, .max_levels = 9, .max_vertices = 1'000'000});
    const auto px = positions(*hierarchy, surface.vertices_mm);
    const Level& finest = hierarchy->finest();
    float longest = 0;
    float shortest_edge = std::numeric_limits<float>::max();
    for (Eigen::Index f = 0; f < finest.triangles.cols(); ++f) {
      const Eigen::Vector3f apex = px.back().col(finest.triangles(0, f));
      const Eigen::Vector3f start = px.back().col(finest.triangles(1, f));
      const Eigen::Vector3f end = px.back().col(finest.triangles(2, f));
      longest = std::max(longest, (start - end).norm());
      shortest_edge = std::min({shortest_edge, (start - apex).norm(), (end - apex).norm()});
    }
    EXPECT_LE(longest, epsilon * 1.0001F);
    // The last split edges were longer than epsilon, so half of it is the shortest that a regular split
    // leaves; the masks next to the boundary take a little off.
    EXPECT_GT(shortest_edge, 0.45F * epsilon);
  }
}

TEST(Hierarchy, LeavesWhatTheCameraCannotSee) {
  Surface surface = test::plane(8, 8, 10);
  for (Eigen::Index v = 0; v < surface.projected_px.cols(); ++v) {
    if (surface.vertices_mm(0, v) > 35) {
      surface.projected_px.col(v).setConstant(std::numeric_limits<float>::quiet_NaN());
    }
  }
  const auto hierarchy = build(surface, {.min_edge_px = 1});
  expect_conforming(*hierarchy, 1, 1);
  const auto levels = positions(*hierarchy, surface.vertices_mm);
  ASSERT_TRUE(levels.back().allFinite());
  std::size_t fine_seen = 0;
  std::size_t fine_unseen = 0;
  const std::int32_t coarse_count = hierarchy->levels[0].vertex_count;
  for (Eigen::Index v = coarse_count; v < levels.back().cols(); ++v) {
    ++(levels.back()(0, v) < 30 ? fine_seen : fine_unseen);
  }
  EXPECT_GT(fine_seen, 3000U);
  EXPECT_LT(fine_unseen, fine_seen / 5) << "only what grading needs";
}

TEST(Hierarchy, BoundsAreKept) {
  const Surface surface = test::plane(10, 10, 10);
  const auto bounded = build(surface, {.min_edge_px = 0.2F, .max_levels = 9, .max_vertices = 3000});
  EXPECT_LE(bounded->finest().vertex_count, 3000);
  EXPECT_GT(bounded->finest().vertex_count, 1400) << "the last sweep that fits is made";
  EXPECT_EQ(build(surface, {.min_edge_px = 0.2F, .max_levels = 2})->levels.size(), 2U);
  EXPECT_EQ(build(surface, {.min_edge_px = 0.2F, .max_levels = 9, .max_vertices = 1})->levels.size(), 1U);
}

TEST(Hierarchy, EveryLevelIsWorthItsSolve) {
  Surface surface = test::plane(12, 12, 10);
  // One block is much larger in the image than all others: it alone could be split further.
  surface.projected_px.col(84) += Eigen::Vector2f(30, 0);
  const auto hierarchy = build(surface, {.min_edge_px = 4, .max_levels = 9});
  ASSERT_GT(hierarchy->levels.size(), 1U);
  for (std::size_t l = 2; l < hierarchy->levels.size(); ++l) {
    EXPECT_GE(hierarchy->levels[l].vertex_count,
              static_cast<std::int32_t>(1.1F * static_cast<float>(hierarchy->levels[l - 1].vertex_count)));
  }
  // The last sweeps are there all the same: no interior edge longer than epsilon is left.
  const Vertices px = (Vertices(3, surface.projected_px.cols()) << surface.projected_px,
                       Eigen::RowVectorXf::Zero(surface.projected_px.cols()))
                          .finished();
  const Vertices finest = positions(*hierarchy, px).back();
  for (Eigen::Index f = 0; f < hierarchy->finest().triangles.cols(); ++f) {
    const auto face = hierarchy->finest().triangles.col(f);
    EXPECT_LE((finest.col(face[1]) - finest.col(face[2])).norm(), 4.001F);
  }
}

TEST(Hierarchy, IdIsThatOfTheContent) {
  const Surface surface = test::sphere(4, 60);
  const auto first = build(surface, {.min_edge_px = 4});
  const auto again = build(surface, {.min_edge_px = 4});
  const auto finer = build(surface, {.min_edge_px = 3});
  EXPECT_NE(first->id, 0U);
  EXPECT_EQ(first->id, again->id);
  EXPECT_NE(first->id, finer->id);
  // The value itself is stored in takes: it must be the same on every machine and in every version.
  EXPECT_EQ(build(test::plane(2, 2, 1), {.max_levels = 1})->id, 12081840228653647845U);
}

TEST(Hierarchy, RebuildFinestMovesAlongTheCoarseNormals) {
  const Surface surface = test::sphere(5, 50);
  const auto hierarchy = build(surface, {.min_edge_px = 4});
  const auto levels = positions(*hierarchy, surface.vertices_mm);
  Vertices vertices;
  Eigen::Matrix3Xf normals;
  rebuild_finest(*hierarchy, surface.vertices_mm, {}, vertices, normals);
  EXPECT_EQ(vertices, levels.back());
  Eigen::Matrix3Xf coarse_normals = normals;
  const std::vector<float> displacements(static_cast<std::size_t>(hierarchy->finest().vertex_count), 2.5F);
  rebuild_finest(*hierarchy, surface.vertices_mm, displacements, vertices, normals);
  EXPECT_LT((vertices - levels.back() - 2.5F * coarse_normals).cwiseAbs().maxCoeff(), 1e-5F);
  EXPECT_NEAR(vertices.colwise().norm().mean(), levels.back().colwise().norm().mean() + 2.5F, 0.02F);
  Eigen::Matrix3Xf expected;
  vertex_normals(vertices, hierarchy->finest().triangles, expected);
  EXPECT_EQ(normals, expected);
}

TEST(Hierarchy, DegenerateControlMeshesAreNamed) {
  Surface flipped = test::plane(3, 3, 1);
  std::swap(flipped.control.quads(1, 4), flipped.control.quads(3, 4));
  EXPECT_THAT(error_of([&] { build(flipped, {}); }), HasSubstr("both run along edge"));

  Surface repeated = test::plane(3, 3, 1);
  repeated.control.quads(2, 5) = repeated.control.quads(0, 5);
  EXPECT_THAT(error_of([&] { build(repeated, {}); }), HasSubstr("quad 5 names vertex"));

  Surface outside = test::plane(3, 3, 1);
  outside.control.quads(2, 5) = 99;
  EXPECT_THAT(error_of([&] { build(outside, {}); }), HasSubstr("names vertex 99; the mesh has 16"));

  Surface pinched = test::plane(2, 2, 1);
  pinched.control.quads = Quads(pinched.control.quads(Eigen::all, std::vector<int>{0, 3}));
  EXPECT_THAT(error_of([&] { build(pinched, {}); }), HasSubstr("belongs to no face"));
  // Vertices 2 and 6 are the corners that only the missing quads had.
  Surface touching = test::plane(2, 2, 1);
  touching.control.quads = Quads(4, 2);
  touching.control.quads << 0, 3, 1, 4, 2, 5, 3, 6;
  touching.control.vertex_count = 7;
  touching.control.quads.col(1) << 2, 4, 5, 6;
  touching.control.texture_coordinates.conservativeResize(2, 7);
  touching.projected_px.conservativeResize(2, 7);
  touching.control.refinable.resize(7);
  touching.facing.resize(7);
  EXPECT_THAT(error_of([&] { build(touching, {}); }), HasSubstr("round vertex 2"));

  Surface short_flags = test::plane(2, 2, 1);
  short_flags.facing.pop_back();
  EXPECT_THAT(error_of([&] { build(short_flags, {}); }), HasSubstr("facing flags of 8"));

  Surface empty;
  EXPECT_THAT(error_of([&] { build(empty, {}); }), HasSubstr("no quads"));

  EXPECT_THAT(error_of([&] { build(test::plane(2, 2, 1), {.max_levels = 0}); }), HasSubstr("max_levels"));
  EXPECT_THAT(error_of([&] { build(test::plane(2, 2, 1), {.min_edge_px = NAN}); }), HasSubstr("min_edge_px"));
}

TEST(SameTopology, LooksAtWhatIsThereAndNotAtTheIdAlone) {
  const Hierarchy one = *build(test::plane(4, 4, 100), {});
  EXPECT_EQ(topology_id(one), one.id);
  EXPECT_TRUE(same_topology(one, Hierarchy(one)));

  const std::vector<std::function<void(Hierarchy&)>> lies = {
      [](Hierarchy& other) { ++other.id; },
      [](Hierarchy& other) { ++other.control_vertex_count; },
      [](Hierarchy& other) { other.levels.pop_back(); },
      [](Hierarchy& other) { ++other.levels.back().vertex_count; },
      [](Hierarchy& other) { other.levels.front().triangles.conservativeResize(3, 1); },
      [](Hierarchy& other) { std::swap(other.levels[0].triangles(0, 0), other.levels[0].triangles(1, 0)); },
      [](Hierarchy& other) { other.levels.back().from_coarser.columns.pop_back(); },
      [](Hierarchy& other) { other.levels.back().from_coarser.weights.front() += 0.5F; }};
  for (std::size_t k = 0; k < lies.size(); ++k) {
    Hierarchy other = one;
    lies[k](other);
    EXPECT_FALSE(same_topology(one, other)) << "lie " << k;
    EXPECT_FALSE(same_topology(other, one)) << "lie " << k;
  }
}

}  // namespace
}  // namespace facet::mesh
