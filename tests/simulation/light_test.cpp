#include "simulation/light.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "facet/error.hpp"
#include "maths/harmonics.hpp"
#include "render/renderer.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

float value(const std::array<float, 9>& lighting, const Eigen::Vector3f& normal) {
  const auto basis = maths::harmonics(normal.x(), normal.y(), normal.z());
  float sum = 0;
  for (std::size_t k = 0; k < 9; ++k) {
    sum += lighting[k] * basis[k];
  }
  return sum;
}

Eigen::Vector3f random_direction(Random& random) {
  return Eigen::Vector3f(random.normal(), random.normal(), random.normal()).normalized();
}

TEST(DistantLight, IsTheSecondOrderFormOfTheClampedCosine) {
  Random random(5, 0);
  for (int k = 0; k < 2000; ++k) {
    const Eigen::Vector3f direction = random_direction(random);
    const Eigen::Vector3f normal = random_direction(random);
    const float cosine = normal.dot(direction);
    const auto lighting = distant_light_sh(direction);
    EXPECT_NEAR(value(lighting, normal), 0.25F + 0.5F * cosine + 5.0F / 32 * (3 * cosine * cosine - 1),
                1e-5F);
    // [RH01]: the second order is within a few per cent of the true irradiance.
    EXPECT_NEAR(value(lighting, normal), std::max(0.0F, cosine), 0.1F);
  }
}

TEST(MakeLighting, LightsTheFaceFromOneSideAndNeverNegatively) {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    const Lighting lighting = make_lighting(LightKind::SphericalHarmonics, seed, {0, 0, 600});
    Random random(seed, 9);
    for (int k = 0; k < 300; ++k) {
      EXPECT_GT(render::irradiance(lighting.spherical_harmonics, random_direction(random)), 0) << seed;
    }
    const float right =
        render::irradiance(lighting.spherical_harmonics, Eigen::Vector3f(1, 0, -1).normalized());
    const float left =
        render::irradiance(lighting.spherical_harmonics, Eigen::Vector3f(-1, 0, -1).normalized());
    EXPECT_GT(std::max(left, right) / std::min(left, right), 1.2F) << seed;  // shading has a gradient
  }
}

TEST(MakeLighting, AreaLightsFaceTheHead) {
  const Eigen::Vector3f head(20, -10, 620);
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    const Lighting lighting = make_lighting(LightKind::Area, seed, head);
    ASSERT_EQ(lighting.area_lights.size(), 2U);
    for (const AreaLight& light : lighting.area_lights) {
      EXPECT_NEAR((head - light.centre_mm).normalized().dot(light.normal), 1, 1e-4F);
      EXPECT_NEAR((head - light.centre_mm).norm(), light.reference_distance_mm, 0.1F);
      EXPECT_NEAR(light.half_u_mm.dot(light.normal), 0, 0.05F);
      EXPECT_NEAR(light.half_v_mm.dot(light.half_u_mm), 0, 1.0F);
      Eigen::Vector3f mean = Eigen::Vector3f::Zero();
      const auto points = light_points_mm(light, 4);
      ASSERT_EQ(points.size(), 16U);
      for (const auto& point : points) {
        mean += point / 16;
        EXPECT_LE(std::abs((point - light.centre_mm).dot(light.half_u_mm)),
                  1.001F * light.half_u_mm.squaredNorm());
        EXPECT_LE(std::abs((point - light.centre_mm).dot(light.half_v_mm)),
                  1.001F * light.half_v_mm.squaredNorm());
      }
      EXPECT_LT((mean - light.centre_mm).norm(), 0.2F * light.half_u_mm.norm());
    }
  }
}

TEST(MakeLighting, NearLightsStandWhereTheyAreSaidToAndFaceTheHead) {
  const Eigen::Vector3f head(20, -10, 620);
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    for (const LightKind kind : {LightKind::Lamps, LightKind::Window, LightKind::Ring, LightKind::Strobe}) {
      const Lighting lighting = make_lighting(kind, seed, head);
      EXPECT_EQ(lighting.kind, kind);
      EXPECT_EQ(parse_light(light_name(kind)), kind);
      ASSERT_FALSE(lighting.area_lights.empty());
      Eigen::Vector3f sum = Eigen::Vector3f::Zero();
      for (const AreaLight& light : lighting.area_lights) {
        EXPECT_NEAR((head - light.centre_mm).normalized().dot(light.normal), 1, 1e-4F);
        EXPECT_NEAR((head - light.centre_mm).norm(), light.reference_distance_mm, 0.1F);
        EXPECT_LT(light.centre_mm.z(), head.z() + 100);  // none behind the head
        sum += light.irradiance;
        if (kind == LightKind::Lamps) {
          EXPECT_GE(light.reference_distance_mm, 400);
          EXPECT_LE(light.reference_distance_mm, 800);
        }
        if (kind == LightKind::Ring) {
          EXPECT_NEAR(light.centre_mm.z(), 0, 1e-3F);
          EXPECT_GT(light.centre_mm.norm(), 100);
        }
      }
      EXPECT_GT(sum.minCoeff(), 0.9F);
    }
  }
}

TEST(MakeLighting, AStrobeFiresOneLampAFrameInTurn) {
  const Lighting all = make_lighting(LightKind::Strobe, 3, {0, 0, 600});
  ASSERT_EQ(all.area_lights.size(), 6U);
  for (int frame = 0; frame < 13; ++frame) {
    const Lighting now = lighting_of_frame(all, frame);
    ASSERT_EQ(now.area_lights.size(), 1U);
    EXPECT_EQ(now.area_lights[0].centre_mm, all.area_lights[static_cast<std::size_t>(frame % 6)].centre_mm);
  }
  const Lighting window = make_lighting(LightKind::Window, 3, {0, 0, 600});
  EXPECT_EQ(lighting_of_frame(window, 4).area_lights.size(), window.area_lights.size());
  EXPECT_THROW(parse_light("sun"), Error);
}

}  // namespace
}  // namespace facet::simulation
