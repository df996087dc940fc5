#include "fit/fine_surface.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <limits>
#include <random>

#include "facet/error.hpp"
#include "render/renderer.hpp"
#include "support/synthetic_model.hpp"

namespace facet::fit {
namespace {

using capture::DepthMap;
using capture::Lens;
using Eigen::Vector3d;
using Eigen::Vector3f;

/// A template that looks along z at two cameras 900 mm away.
struct Scene {
  Scene() : model(test::synthetic_model()) {
    surface = std::make_shared<const TemplateMesh>(make_template(model, 3000));
  }
  face::FaceModel model;
  std::shared_ptr<const TemplateMesh> surface;
};
const Scene& scene() {
  static const Scene made;
  return made;
}

FineSurface fine_surface(int sweeps = 2) {
  FineOptions options;
  options.sweeps = sweeps;
  return {scene().model.control, scene().surface, options};
}

/// What two cameras see of a mesh, with white noise.
std::vector<DepthMap> depths_of(const mesh::Vertices& vertices_mm, const mesh::Triangles& triangles,
                                double noise_mm) {
  std::mt19937_64 random(3);
  std::normal_distribution<float> noise(0, 1);
  std::vector<DepthMap> maps;
  for (const double angle_rad : {-0.35, 0.35}) {
    DepthMap& map = maps.emplace_back();
    map.lens.width_px = map.lens.height_px = map.width_px = map.height_px = 320;
    map.lens.fx_px = map.lens.fy_px = 1000;
    map.lens.cx_px = map.lens.cy_px = 159.5;
    Eigen::Matrix3d upright;  // looks along -z, y down
    upright << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    map.lens.camera_from_rig = Eigen::Translation3d(0, 0, 900) *
                               Eigen::Isometry3d(Eigen::Quaterniond(upright)) *
                               Eigen::AngleAxisd(angle_rad, Vector3d::UnitY());
    const Eigen::Isometry3f camera_from_rig = map.lens.camera_from_rig.cast<float>();
    const mesh::Vertices seen =
        (camera_from_rig.linear() * vertices_mm).colwise() + camera_from_rig.translation();
    map.depth_mm = render::Raycaster(seen, triangles).cast({1000, 1000, 159.5F, 159.5F, 320, 320}).depth_mm;
    map.sigma_mm.assign(map.depth_mm.size(), 0.1F);
    for (float& depth : map.depth_mm) {
      map.confidence.push_back(depth > 0 ? 1.0F : 0.0F);
      depth += depth > 0 ? static_cast<float>(noise_mm) * noise(random) : 0.0F;
    }
  }
  return maps;
}

/// Wrinkles of 10 mm along y.
std::vector<float> wrinkles(const mesh::Hierarchy& hierarchy, const std::vector<mesh::Vertices>& levels) {
  std::vector<float> displacements_mm;
  for (std::int32_t i = 0; i < hierarchy.finest().vertex_count; ++i) {
    displacements_mm.push_back(0.4F * std::sin(levels.back()(1, i) * 2 * 3.14159F / 10));
  }
  return displacements_mm;
}

// What shading adds may fold the surface where it is hollow.
TEST(FineSurface, WhatIsAddedTurnsNoTriangleOver) {
  FineSurface fine = fine_surface();
  const mesh::Hierarchy& hierarchy = *fine.hierarchy();
  const mesh::Triangles& triangles = hierarchy.finest().triangles;
  mesh::Vertices template_mm = scene().surface->neutral_mm;
  for (Eigen::Index v = 0; v < template_mm.cols(); ++v) {
    template_mm(2, v) += 3 * std::sin(template_mm(0, v) * 2 * 3.14159F / 20);
  }
  const auto count = static_cast<std::size_t>(hierarchy.finest().vertex_count);
  mesh::Vertices fine_mm;
  Eigen::Matrix3Xf normals;
  const auto folded = [&](const std::vector<float>& displacements_mm) {
    mesh::rebuild_finest(hierarchy, template_mm, displacements_mm, fine_mm, normals);
    int found = 0;
    for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
      const auto corner = triangles.col(t);
      const Vector3f across = (fine_mm.col(corner[1]) - fine_mm.col(corner[0]))
                                  .cross(fine_mm.col(corner[2]) - fine_mm.col(corner[0]));
      found +=
          across.dot(normals.col(corner[0]) + normals.col(corner[1]) + normals.col(corner[2])) < 0 ? 1 : 0;
    }
    return found;
  };
  const std::vector<float> none(count, 0.0F);
  std::vector<float> sum_mm;
  EXPECT_EQ(fine.add(template_mm, none, std::vector<float>(count, 0.125F), sum_mm), 0);
  EXPECT_EQ(sum_mm, std::vector<float>(count, 0.125F)) << "what folds nothing stays as it is";

  const int before = folded(none);
  // Normals meet 3 mm above the waves' valleys.
  std::vector<float> raised(count);
  for (std::size_t i = 0; i < count; ++i) {
    raised[i] = fine_mm(0, static_cast<Eigen::Index>(i)) > 0 ? 10.0F : 0.05F;
  }
  ASSERT_GT(folded(raised), before + 20) << "or the test shows nothing";
  EXPECT_GT(fine.add(template_mm, none, raised, sum_mm), 20);
  EXPECT_EQ(folded(sum_mm), before);
  std::size_t untouched = 0;
  for (std::size_t i = 0; i < count; ++i) {
    EXPECT_LE(std::abs(sum_mm[i]), std::abs(raised[i]));
    untouched += sum_mm[i] == raised[i] ? 1 : 0;
  }
  EXPECT_GT(untouched, count / 2) << "only what is folded is taken back";

  EXPECT_THROW(fine.add(template_mm, none, std::vector<float>(3), sum_mm), Error);
}

TEST(FineSurface, ItsHierarchyBeginsWithTheTemplate) {
  const FineSurface fine = fine_surface();
  const mesh::Hierarchy& hierarchy = *fine.hierarchy();
  const TemplateMesh& surface = *scene().surface;
  EXPECT_NE(hierarchy.id, 0U);
  EXPECT_EQ(hierarchy.control_vertex_count, surface.vertex_count());
  EXPECT_EQ(hierarchy.levels.front().triangles, surface.triangles);
  std::vector<mesh::Vertices> levels;
  mesh::push_positions(hierarchy, surface.neutral_mm, levels);
  EXPECT_EQ(levels.front(), surface.neutral_mm);
  EXPECT_GT(hierarchy.finest().vertex_count, 3 * surface.vertex_count() / 2);
  EXPECT_EQ(hierarchy.texture_coordinates.cols(), hierarchy.finest().vertex_count);
  // The control mesh refined in one go: the same surface, texture coordinates included.
  Eigen::MatrixXf direct;
  mesh::apply(surface.from_control, Eigen::MatrixXf(scene().model.control.texture_coordinates), direct);
  Eigen::MatrixXf further;
  mesh::apply(hierarchy.finest().from_coarser, direct, further);
  EXPECT_LT((further - hierarchy.texture_coordinates).cwiseAbs().maxCoeff(), 1e-4F);
  // Only the face's skin is refined.
  EXPECT_LT(hierarchy.finest().vertex_count, 4 * surface.vertex_count());
  // No two steps are one: another depth is another topology.
  EXPECT_NE(fine_surface(1).hierarchy()->id, hierarchy.id);
}

TEST(FineSurface, FindsWrinklesThatTheTemplateLacks) {
  FineSurface fine = fine_surface(4);
  const mesh::Hierarchy& hierarchy = *fine.hierarchy();
  const mesh::Vertices& template_mm = scene().surface->neutral_mm;
  std::vector<mesh::Vertices> levels;
  mesh::push_positions(hierarchy, template_mm, levels);
  const std::vector<float> true_mm = wrinkles(hierarchy, levels);
  mesh::Vertices truth_mm;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(hierarchy, template_mm, true_mm, truth_mm, normals);
  std::vector<float> found_mm;
  std::vector<float> confidence;
  const TemplateFitReport report =
      fine.fit(depths_of(truth_mm, hierarchy.finest().triangles, 0.1), template_mm, found_mm, confidence);
  EXPECT_TRUE(report.failure.empty()) << report.failure;
  EXPECT_GT(report.seen, 0.8);
  ASSERT_EQ(found_mm.size(), true_mm.size());
  double squares = 0;
  double squares_before = 0;
  int count = 0;
  for (std::size_t i = 0; i < found_mm.size(); ++i) {
    EXPECT_GE(confidence[i], 0);
    EXPECT_LE(confidence[i], 1);
    if (confidence[i] > 0.5F) {
      squares += std::pow(static_cast<double>(found_mm[i] - true_mm[i]), 2);
      squares_before += std::pow(static_cast<double>(true_mm[i]), 2);
      ++count;
    }
  }
  ASSERT_GT(count, 1000);
  EXPECT_LT(std::sqrt(squares / count), 0.09) << "below the depth's noise";
  EXPECT_GT(std::sqrt(squares_before / count), 0.2) << "or the test shows nothing";
}

TEST(FineSurface, NoiseIsNoWrinkle) {
  FineSurface fine = fine_surface(4);
  const mesh::Vertices& template_mm = scene().surface->neutral_mm;
  mesh::Vertices truth_mm;
  Eigen::Matrix3Xf normals;
  mesh::rebuild_finest(*fine.hierarchy(), template_mm, {}, truth_mm, normals);
  std::vector<float> found_mm;
  std::vector<float> confidence;
  fine.fit(depths_of(truth_mm, fine.hierarchy()->finest().triangles, 0.1), template_mm, found_mm, confidence);
  double squares = 0;
  for (const float displacement : found_mm) {
    squares += static_cast<double>(displacement * displacement);
  }
  EXPECT_LT(std::sqrt(squares / static_cast<double>(found_mm.size())), 0.05);
}

TEST(FineSurface, WhereNoMapSeesItItStaysOnTheTemplate) {
  FineSurface fine = fine_surface();
  const mesh::Vertices& template_mm = scene().surface->neutral_mm;
  std::vector<mesh::Vertices> levels;
  mesh::push_positions(*fine.hierarchy(), template_mm, levels);
  mesh::Vertices near_mm = levels.back();
  near_mm.row(2).array() += 0.5F;
  std::vector<DepthMap> maps = depths_of(near_mm, fine.hierarchy()->finest().triangles, 0);
  for (DepthMap& map : maps) {  // the upper half is hidden
    std::fill_n(map.depth_mm.begin(), map.depth_mm.size() / 2, 0.0F);
    std::fill_n(map.confidence.begin(), map.confidence.size() / 2, 0.0F);
  }
  std::vector<float> found_mm;
  std::vector<float> confidence;
  fine.fit(maps, template_mm, found_mm, confidence);
  float lower = 0;
  for (std::size_t i = 0; i < found_mm.size(); ++i) {
    const float y = levels.back()(1, static_cast<Eigen::Index>(i));
    if (y > 15) {
      EXPECT_NEAR(found_mm[i], 0, 0.02) << y;
      EXPECT_EQ(confidence[i], 0) << y;
    }
    lower = std::max(lower, found_mm[i]);
  }
  EXPECT_GT(lower, 0.4F);
}

TEST(FineSurface, WithoutDepthItSaysSo) {
  FineSurface fine = fine_surface();
  std::vector<float> found_mm;
  std::vector<float> confidence;
  const TemplateFitReport report = fine.fit({}, scene().surface->neutral_mm, found_mm, confidence);
  EXPECT_EQ(report.outcome, TemplateFitOutcome::NoData);
  EXPECT_THAT(report.failure, ::testing::HasSubstr("of the fine skin lies on a depth map"));
  EXPECT_THAT(found_mm, ::testing::Each(0.0F));
  EXPECT_THAT(confidence, ::testing::Each(0.0F));
  EXPECT_EQ(found_mm.size(), static_cast<std::size_t>(fine.hierarchy()->finest().vertex_count));
}

TEST(FineSurface, NumbersThatAreNoneDoNoHarm) {
  FineSurface fine = fine_surface();
  std::vector<DepthMap> maps = depths_of(scene().surface->neutral_mm, scene().surface->triangles, 0);
  for (std::size_t i = 0; i < maps[0].depth_mm.size(); i += 3) {
    maps[0].depth_mm[i] =
        i % 2 == 0 ? std::numeric_limits<float>::quiet_NaN() : std::numeric_limits<float>::infinity();
  }
  std::vector<float> found_mm;
  std::vector<float> confidence;
  EXPECT_NE(fine.fit(maps, scene().surface->neutral_mm, found_mm, confidence).outcome,
            TemplateFitOutcome::NumericalFailure);
  EXPECT_THAT(found_mm, ::testing::Each(::testing::Truly([](float one) { return std::isfinite(one); })));
}

TEST(FineSurface, WrongUseIsNamed) {
  mesh::ControlMesh other = scene().model.control;
  const auto with = [&](const mesh::ControlMesh& control, int sweeps, double sigma_mm) {
    FineOptions options;
    options.sweeps = sweeps;
    options.sigma_mm = sigma_mm;
    return FineSurface(control, scene().surface, options);
  };
  EXPECT_THROW(with(scene().model.control, 0, 3), Error);
  EXPECT_THROW(with(scene().model.control, 2, 0), Error);
  FineSurface fine = fine_surface();
  std::vector<float> found_mm(7);
  std::vector<float> confidence;
  EXPECT_THAT([&] { fine.fit({}, scene().surface->neutral_mm, found_mm, confidence); },
              ::testing::ThrowsMessage<Error>(::testing::HasSubstr("not ")));
  EXPECT_THROW(FineSurface(scene().model.control,
                           std::make_shared<const TemplateMesh>(
                               TemplateMesh{mesh::Vertices::Zero(3, 17), {}, {}, {}, {}, {}, {}}),
                           {}),
               Error);
}

}  // namespace
}  // namespace facet::fit
