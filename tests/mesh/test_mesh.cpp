#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <random>
#include <string>

#include "facet/error.hpp"
#include "mesh/mesh.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::mesh {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

Triangles triangles_of(std::initializer_list<std::array<std::int32_t, 3>> list) {
  Triangles triangles(3, static_cast<Eigen::Index>(list.size()));
  Eigen::Index t = 0;
  for (const auto& triangle : list) {
    triangles.col(t++) << triangle[0], triangle[1], triangle[2];
  }
  return triangles;
}

std::vector<std::int32_t> ring_of(const OneRings& rings, std::size_t vertex) {
  return {rings.neighbours.begin() + rings.offsets[vertex],
          rings.neighbours.begin() + rings.offsets[vertex + 1]};
}

std::string error_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::UnreadableInput);
    return error.what();
  }
  return "no error";
}

TEST(OneRings, InnerRingIsClosedAndCounterClockwise) {
  // A fan of four round vertex 0.
  const OneRings rings = build_one_rings(triangles_of({{0, 1, 2}, {3, 4, 0}, {2, 3, 0}, {4, 1, 0}}), 5);
  std::vector<std::int32_t> ring = ring_of(rings, 0);
  std::rotate(ring.begin(), std::find(ring.begin(), ring.end(), 1), ring.end());
  EXPECT_THAT(ring, ElementsAre(1, 2, 3, 4));
  EXPECT_THAT(rings.on_boundary, ElementsAre(0, 1, 1, 1, 1));
}

TEST(OneRings, BoundaryRingRunsFromOneOpenEdgeToTheOther) {
  const OneRings rings = build_one_rings(triangles_of({{0, 2, 3}, {0, 1, 2}, {0, 3, 4}}), 5);
  EXPECT_THAT(ring_of(rings, 0), ElementsAre(1, 2, 3, 4));
  EXPECT_THAT(ring_of(rings, 1), ElementsAre(2, 0));
}

TEST(OneRings, ErrorsNameWhatIsWrong) {
  EXPECT_THAT(error_of([] {
                build_one_rings(triangles_of({{0, 1, 7}}), 3);
              }),
              HasSubstr("triangle 0 names vertices 0, 1, 7; the mesh has 3"));
  EXPECT_THAT(error_of([] {
                build_one_rings(triangles_of({{0, 1, 2}, {2, 1, 1}}), 3);
              }),
              HasSubstr("triangle 1 names vertex 1 twice"));
  EXPECT_THAT(error_of([] {
                build_one_rings(triangles_of({{0, 1, 2}, {0, 1, 3}}), 4);
              }),
              HasSubstr("edge 0-1 is used twice"));
  EXPECT_THAT(error_of([] {
                build_one_rings(triangles_of({{0, 1, 2}}), 4);
              }),
              HasSubstr("vertex 3 belongs to no face"));
  EXPECT_THAT(error_of([] {
                build_one_rings(triangles_of({{0, 1, 2}, {0, 3, 4}}), 5);
              }),
              HasSubstr("round vertex 0"));
  // Two closed fans that touch in vertex 0.
  EXPECT_THAT(
      error_of([] {
        build_one_rings(triangles_of({{0, 1, 2}, {0, 2, 3}, {0, 3, 1}, {0, 4, 5}, {0, 5, 6}, {0, 6, 4}}), 7);
      }),
      HasSubstr("round vertex 0"));
}

TEST(VertexNormals, AreWeightedByArea) {
  Vertices vertices(3, 5);
  // Two triangles at vertex 0: area 2 with normal z, area 0.5 with normal x.
  vertices << 0, 2, 0, 0, 0,  //
      0, 0, 2, 1, 0,          //
      0, 0, 0, 0, 1;
  Eigen::Matrix3Xf normals;
  vertex_normals(vertices, triangles_of({{0, 1, 2}, {0, 3, 4}}), normals);
  EXPECT_TRUE(normals.col(0).isApprox(Eigen::Vector3f(0.5F, 0, 2).normalized(), 1e-6F));
  EXPECT_TRUE(normals.col(1).isApprox(Eigen::Vector3f(0, 0, 1)));
  EXPECT_TRUE(normals.col(3).isApprox(Eigen::Vector3f(1, 0, 0)));
}

TEST(VertexNormals, WithoutAreaAreZero) {
  Vertices vertices = Vertices::Zero(3, 4);
  vertices.col(1) << 1, 0, 0;
  vertices.col(2) << 2, 0, 0;
  Eigen::Matrix3Xf normals;
  vertex_normals(vertices, triangles_of({{0, 1, 2}}), normals);
  EXPECT_EQ(normals, (Eigen::Matrix3Xf::Zero(3, 4)));
}

TEST(Apply, AgreesWithADenseProduct) {
  constexpr unsigned kSeed = 20261121;
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> value(-1, 1);
  const std::int32_t in_count = 127;
  const std::int32_t out_count = 211;
  SparseRows rows;
  Eigen::MatrixXf dense = Eigen::MatrixXf::Zero(in_count, out_count);
  rows.row_offsets.push_back(0);
  for (std::int32_t row = 0; row < out_count; ++row) {
    for (std::int32_t entry = 0; entry < row % 5; ++entry) {
      rows.columns.push_back((row * 31 + entry * 17) % in_count);
      rows.weights.push_back(value(random));
      dense(rows.columns.back(), row) += rows.weights.back();
    }
    rows.row_offsets.push_back(static_cast<std::int32_t>(rows.columns.size()));
  }
  for (const Eigen::Index height : {1, 2, 3, 9}) {
    const Eigen::MatrixXf in = Eigen::MatrixXf::Random(height, in_count);
    Eigen::MatrixXf out;
    apply(rows, in, out);
    EXPECT_LT((out - in * dense).cwiseAbs().maxCoeff(), 1e-5F) << "seed " << kSeed;
  }
  const Vertices in = Vertices::Random(3, in_count);
  Vertices out;
  apply(rows, in, out);
  EXPECT_LT((out - in * dense).cwiseAbs().maxCoeff(), 1e-5F);
}

TEST(TrackingState, NamesAreThoseOfTheWire) {
  EXPECT_STREQ(to_string(TrackingState::Searching), "searching");
  EXPECT_STREQ(to_string(TrackingState::Acquiring), "acquiring");
  EXPECT_STREQ(to_string(TrackingState::Tracking), "tracking");
  EXPECT_STREQ(to_string(TrackingState::Lost), "lost");
}

}  // namespace
}  // namespace facet::mesh
