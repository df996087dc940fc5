// The ray caster against shapes whose answers are known in closed form.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <atomic>
#include <cmath>
#include <random>

#include "facet/error.hpp"
#include "render/renderer.hpp"

namespace facet::render {
namespace {

struct Shape {
  mesh::Vertices vertices_mm;
  mesh::Triangles triangles;
};

/// A latitude-longitude sphere, counter-clockwise seen from outside. Its faces lie within
/// radius * (1 - cos(pi / rings)) of the true sphere.
Shape sphere(const Eigen::Vector3f& centre_mm, float radius_mm, int rings) {
  Shape shape;
  const int around = 2 * rings;
  shape.vertices_mm.resize(3, (rings + 1) * around);
  shape.triangles.resize(3, 2 * rings * around);
  for (int ring = 0; ring <= rings; ++ring) {
    const float polar = static_cast<float>(M_PI) * static_cast<float>(ring) / static_cast<float>(rings);
    for (int step = 0; step < around; ++step) {
      const float turn = static_cast<float>(M_PI) * static_cast<float>(step) / static_cast<float>(rings);
      shape.vertices_mm.col(ring * around + step) =
          centre_mm + radius_mm * Eigen::Vector3f(std::sin(polar) * std::cos(turn), std::cos(polar),
                                                  -std::sin(polar) * std::sin(turn));
    }
  }
  int next = 0;
  for (int ring = 0; ring < rings; ++ring) {
    for (int step = 0; step < around; ++step) {
      const int a = ring * around + step;
      const int b = ring * around + (step + 1) % around;
      shape.triangles.col(next++) << a, a + around, b + around;
      shape.triangles.col(next++) << a, b + around, b;
    }
  }
  return shape;
}

const Eigen::Vector3f kCentre_mm{10, -20, 500};
constexpr float kRadius_mm = 80;
constexpr int kRings = 200;
const float kSag_mm = kRadius_mm * (1 - std::cos(static_cast<float>(M_PI) / kRings));
constexpr CameraIntrinsics kCamera{300, 310, 79.5F, 60, 161, 121};

class OnSphere : public testing::Test {
 protected:
  Shape shape = sphere(kCentre_mm, kRadius_mm, kRings);
  Raycaster caster{shape.vertices_mm, shape.triangles};
};

TEST_F(OnSphere, DepthIsTheSpheres) {
  const Eigen::Vector2f offset{0.3F, -0.2F};
  const HitImage hits = caster.cast(kCamera, offset);
  ASSERT_EQ(hits.width_px, 161);
  ASSERT_EQ(hits.height_px, 121);
  int hit_count = 0;
  for (int y = 0; y < 121; ++y) {
    for (int x = 0; x < 161; ++x) {
      const auto pixel = static_cast<std::size_t>(y * 161 + x);
      const Eigen::Vector3f direction((static_cast<float>(x) + offset.x() - kCamera.cx) / kCamera.fx,
                                      (static_cast<float>(y) + offset.y() - kCamera.cy) / kCamera.fy, 1);
      const float a = direction.squaredNorm();
      const float b = direction.dot(kCentre_mm);
      const float root = b * b - a * (kCentre_mm.squaredNorm() - kRadius_mm * kRadius_mm);
      if (root > 1e-3F * b * b) {  // not on the outline, where the facets' sag decides
        ASSERT_GE(hits.triangle[pixel], 0) << x << ' ' << y;
        EXPECT_NEAR(hits.depth_mm[pixel], (b - std::sqrt(root)) / a, 10 * kSag_mm) << x << ' ' << y;
        ++hit_count;
      } else if (root < 0) {
        EXPECT_EQ(hits.triangle[pixel], -1);
        EXPECT_EQ(hits.depth_mm[pixel], 0);
      }
    }
  }
  EXPECT_GT(hit_count, 5000);
}

TEST_F(OnSphere, InterpolatedPositionsLieOnTheRays) {
  const HitImage hits = caster.cast(kCamera);
  const Eigen::MatrixXf points = interpolate(hits, shape.triangles, shape.vertices_mm);
  ASSERT_EQ(points.rows(), 3);
  ASSERT_EQ(points.cols(), 161 * 121);
  for (int y = 0; y < 121; ++y) {
    for (int x = 0; x < 161; ++x) {
      const auto pixel = static_cast<std::size_t>(y * 161 + x);
      const Eigen::Vector3f point = points.col(y * 161 + x);
      if (hits.triangle[pixel] < 0) {
        EXPECT_EQ(point.norm(), 0);
        continue;
      }
      EXPECT_NEAR(point.z(), hits.depth_mm[pixel], 1e-2F);
      EXPECT_NEAR(kCamera.fx * point.x() / point.z() + kCamera.cx, static_cast<float>(x), 5e-3F);
      EXPECT_NEAR(kCamera.fy * point.y() / point.z() + kCamera.cy, static_cast<float>(y), 5e-3F);
    }
  }
}

TEST_F(OnSphere, ClosestPointIsRadial) {
  std::mt19937 random(7);
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> stretch(0.6F, 1.5F);
  for (int k = 0; k < 500; ++k) {
    const Eigen::Vector3f direction =
        Eigen::Vector3f(normal(random), normal(random), normal(random)).normalized();
    const float distance_mm = kRadius_mm * stretch(random);
    const auto closest = caster.closest_point(kCentre_mm + distance_mm * direction, 100);
    ASSERT_GE(closest.triangle, 0);
    EXPECT_NEAR(closest.distance_mm, std::abs(distance_mm - kRadius_mm), 2 * kSag_mm);
    EXPECT_LT((closest.point_mm - (kCentre_mm + kRadius_mm * direction)).norm(), 0.05F * kRadius_mm);
    EXPECT_LT((interpolate(shape.triangles, closest.triangle, closest.barycentric, shape.vertices_mm) -
               closest.point_mm)
                  .norm(),
              1e-3F);
  }
}

TEST_F(OnSphere, ClosestPointBeyondTheLimitIsNone) {
  const Eigen::Vector3f query_mm = kCentre_mm + Eigen::Vector3f(0, kRadius_mm + 5, 0);
  EXPECT_EQ(caster.closest_point(query_mm, 4.9F).triangle, -1);
  EXPECT_GE(caster.closest_point(query_mm, 5.1F).triangle, 0);
}

TEST_F(OnSphere, FirstHitFromInsideIsABackFace) {
  const Eigen::Vector3f direction = Eigen::Vector3f(1, 2, -3).normalized();
  EXPECT_NEAR(caster.first_hit(kCentre_mm, direction).distance_mm, kRadius_mm, 2 * kSag_mm);
  EXPECT_EQ(caster.first_hit(kCentre_mm, direction, 0, true).triangle, -1);
  const Eigen::Vector3f outside = kCentre_mm + 200 * direction;
  EXPECT_NEAR(caster.first_hit(outside, -direction, 0, true).distance_mm, 200 - kRadius_mm, 2 * kSag_mm);
  EXPECT_NEAR(caster.first_hit(outside, -direction, 150).distance_mm, 200 + kRadius_mm, 2 * kSag_mm);
}

TEST_F(OnSphere, OccludedAcrossAndFreeBeside) {
  const Eigen::Vector3f left = kCentre_mm - Eigen::Vector3f(200, 0, 0);
  const Eigen::Vector3f right = kCentre_mm + Eigen::Vector3f(200, 0, 0);
  EXPECT_TRUE(caster.occluded(left, right, 1));
  EXPECT_FALSE(caster.occluded(left, left + Eigen::Vector3f(0, 100, 0), 1));
  // A point on the surface sees outwards, because the margin steps off the surface.
  EXPECT_FALSE(caster.occluded(kCentre_mm + Eigen::Vector3f(kRadius_mm, 0, 0), right, 1));
  EXPECT_FALSE(caster.occluded(left, left, 1));
}

TEST_F(OnSphere, RenderedDiscCoversTheRightAreaAndBlendsItsEdge) {
  const Picture background = plain_picture(kCamera.width_px, kCamera.height_px, {0, 0, 0});
  const auto white = [](std::int32_t, const Eigen::Vector2f&) -> Eigen::Vector3f {
    return Eigen::Vector3f::Ones();
  };
  const Picture picture = render_surface(caster, kCamera, white, background, 8);
  double area_px = 0;
  int partly = 0;
  for (std::size_t k = 0; k < picture.rgb.size(); k += 3) {
    area_px += srgb8_to_linear(picture.rgb[k]);
    partly += picture.rgb[k] > 0 && picture.rgb[k] < 255 ? 1 : 0;
  }
  // The outline of a sphere seen by a pinhole: a cone of half angle asin(r / d), counted per pixel.
  double expected_px = 0;
  for (int y = 0; y < 121; ++y) {
    for (int x = 0; x < 161; ++x) {
      int inside = 0;
      for (int sub = 0; sub < 64; ++sub) {
        const Eigen::Vector3f direction(
            (static_cast<float>(x) + static_cast<float>(sub % 8) / 8 - 0.4375F - kCamera.cx) / kCamera.fx,
            (static_cast<float>(y) + static_cast<float>(sub / 8) / 8 - 0.4375F - kCamera.cy) / kCamera.fy, 1);
        inside += direction.cross(kCentre_mm).norm() < kRadius_mm * direction.norm() ? 1 : 0;
      }
      expected_px += inside / 64.0;
    }
  }
  EXPECT_NEAR(area_px, expected_px, 0.005 * expected_px);
  EXPECT_GT(partly, 100);
}

TEST(Raycaster, BarycentricWeightsBelongToTheSecondAndThirdVertex) {
  mesh::Vertices vertices(3, 3);
  vertices << -50, 50, -50,  //
      -50, -50, 50,          //
      100, 100, 100;
  mesh::Triangles triangles(3, 1);
  triangles << 0, 1, 2;
  const Raycaster caster(vertices, triangles);
  const auto near_second = caster.first_hit({0, 0, 0}, Eigen::Vector3f(45, -49, 100).normalized());
  ASSERT_EQ(near_second.triangle, 0);
  EXPECT_NEAR(near_second.barycentric.x(), 0.95F, 1e-4F);
  EXPECT_NEAR(near_second.barycentric.y(), 0.01F, 1e-4F);
}

TEST(Raycaster, ClosestPointOnEdgesCornersAndSlivers) {
  mesh::Vertices vertices(3, 4);
  vertices << 0, 10, 0, 20,  //
      0, 0, 10, 0,           //
      0, 0, 0, 0;
  mesh::Triangles triangles(3, 2);
  triangles << 0, 0,  //
      1, 1,           //
      2, 3;           // the second has no area
  const Raycaster caster(vertices, triangles);
  EXPECT_NEAR(caster.closest_point({3, 3, 4}, 100).distance_mm, 4, 1e-5F);
  EXPECT_NEAR(caster.closest_point({-3, -4, 0}, 100).distance_mm, 5, 1e-5F);
  EXPECT_NEAR(caster.closest_point({8, 8, 0}, 100).distance_mm, 6 / std::sqrt(2.0F), 1e-5F);
  EXPECT_NEAR(caster.closest_point({23, 4, 0}, 100).distance_mm, 5, 1e-5F);
  EXPECT_NEAR(caster.closest_point({15, 0, 2}, 100).distance_mm, 2, 1e-5F);
}

TEST_F(OnSphere, QueriesThatAreNotFiniteFindNothing) {
  const Eigen::Vector3f bad(0, std::nanf(""), 0);
  const Eigen::Vector3f far(0, INFINITY, 0);
  const Eigen::Vector3f forward(0, 0, 1);
  EXPECT_EQ(caster.first_hit(bad, forward).triangle, -1);
  EXPECT_EQ(caster.first_hit({0, 0, 0}, far).triangle, -1);
  EXPECT_EQ(caster.first_hit(kCentre_mm, {0, 0, 0}).triangle, -1);
  EXPECT_EQ(caster.closest_point(bad, 1000).triangle, -1);
  EXPECT_EQ(caster.closest_point(kCentre_mm, std::nanf("")).triangle, -1);
  EXPECT_FALSE(caster.occluded(kCentre_mm, far, 1));
  EXPECT_FALSE(caster.occluded(bad, kCentre_mm, 1));
  CameraIntrinsics broken = kCamera;
  broken.fx = 0;
  EXPECT_EQ(caster.cast(broken).triangle[0], -1);
}

TEST(Raycaster, EmptyMeshHitsNothing) {
  const Raycaster caster(mesh::Vertices(3, 0), mesh::Triangles(3, 0));
  EXPECT_EQ(caster.first_hit({0, 0, 0}, {0, 0, 1}).triangle, -1);
  EXPECT_EQ(caster.closest_point({0, 0, 0}, 100).triangle, -1);
  EXPECT_EQ(caster.cast({10, 10, 4, 4, 9, 9}).triangle, std::vector<std::int32_t>(81, -1));
}

TEST(Raycaster, AMeshInMotionIsHitWhereItIsAtTheRaysTime) {
  // A square that faces the eye goes away by 10 mm, then by 40 mm.
  mesh::Vertices key_mm(3, 4);
  key_mm << -50, 50, 50, -50, -50, -50, 50, 50, 100, 100, 100, 100;
  std::vector<mesh::Vertices> keys_mm(3, key_mm);
  keys_mm[1].row(2).setConstant(110);
  keys_mm[2].row(2).setConstant(150);
  mesh::Triangles triangles(3, 2);
  triangles << 0, 0, 1, 2, 2, 3;
  for (const auto build : {Raycaster::Build::Thorough, Raycaster::Build::Quick}) {
    const Raycaster caster(keys_mm, triangles, build);
    for (const auto& [time, depth_mm] : {std::pair{0.0F, 100.0F},
                                         {0.25F, 105.0F},
                                         {0.5F, 110.0F},
                                         {0.75F, 130.0F},
                                         {1.0F, 150.0F},
                                         {2.0F, 150.0F}}) {
      EXPECT_NEAR(caster.first_hit({0, 1, 0}, {0, 0, 1}, 0, false, time).distance_mm, depth_mm, 1e-3F)
          << time;
    }
    EXPECT_EQ(caster.first_hit({0, 1, 0}, {0, 0, 1}, 0, false, std::nanf("")).triangle, -1);
    EXPECT_NEAR(caster.closest_point({0, 1, 0}, 200).distance_mm, 100, 1e-3F);  // at time 0
  }
  keys_mm[1] = mesh::Vertices::Zero(3, 3);
  EXPECT_THROW(Raycaster(keys_mm, triangles), Error);
  EXPECT_THROW(Raycaster(std::vector<mesh::Vertices>{}, triangles), Error);
}

TEST(Raycaster, RefusesBrokenMeshes) {
  const mesh::Vertices vertices = mesh::Vertices::Zero(3, 3);
  mesh::Triangles triangles(3, 1);
  triangles << 0, 1, 3;
  EXPECT_THROW(Raycaster(vertices, triangles), Error);
  triangles << 0, -1, 2;
  EXPECT_THROW(Raycaster(vertices, triangles), Error);
  mesh::Vertices not_finite = vertices;
  not_finite(1, 1) = std::nanf("");
  triangles << 0, 1, 2;
  EXPECT_THROW(Raycaster(not_finite, triangles), Error);
}

TEST(ForEachRow, VisitsEveryRowOnce) {
  for (const int row_count : {0, 1, 2, 13, 127}) {
    std::vector<std::atomic<int>> visits(static_cast<std::size_t>(row_count));
    for_each_row(row_count, [&](int y) { ++visits[static_cast<std::size_t>(y)]; });
    for (const auto& visit : visits) {
      EXPECT_EQ(visit, 1);
    }
  }
}

TEST(SampleOffsets, SpreadOverThePixelAroundItsCentre) {
  EXPECT_EQ(sample_offsets_px(1).front(), Eigen::Vector2f(0, 0));
  for (const int count : {4, 8, 16}) {
    Eigen::Vector2f sum{0, 0};
    const auto offsets = sample_offsets_px(count);
    ASSERT_EQ(offsets.size(), static_cast<std::size_t>(count));
    for (std::size_t k = 0; k < offsets.size(); ++k) {
      EXPECT_LE(offsets[k].cwiseAbs().maxCoeff(), 0.75F);
      sum += offsets[k];
      for (std::size_t other = 0; other < k; ++other) {
        EXPECT_GT((offsets[k] - offsets[other]).norm(), 0.6F / std::sqrt(static_cast<float>(count)));
      }
    }
    EXPECT_LT(sum.norm(), 1e-5F);
  }
}

}  // namespace
}  // namespace facet::render
