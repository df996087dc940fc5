#include "fit/first_shape.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <random>

#include "support/synthetic_model.hpp"

namespace facet::fit {
namespace {

using Eigen::Vector3d;

const face::FaceModel& model() {
  static const face::FaceModel made = test::synthetic_model();
  return made;
}

/// The landmarks of somebody who does something, somewhere in a booth, and their noise.
std::vector<Correspondence> seen(const std::vector<float>& identity, const std::vector<float>& expression,
                                 double noise_mm) {
  mesh::Vertices face_mm;
  model().evaluate(identity, expression, face_mm);
  std::mt19937_64 random(3);
  std::normal_distribution<double> noise(0, noise_mm);
  const Eigen::AngleAxisd turn(0.4, Vector3d(1, 3, -1).normalized());
  std::vector<Correspondence> made;
  for (const face::LandmarkAnchor& anchor : model().landmarks) {
    if (anchor.weights[0] + anchor.weights[1] + anchor.weights[2] > 0.5F) {
      const Vector3d at = face::FaceModel::anchor_point(anchor, face_mm).cast<double>();
      made.push_back({anchor, 1.04 * (turn * at) + Vector3d(20, -15, 900) +
                                  Vector3d(noise(random), noise(random), noise(random))});
    }
  }
  return made;
}

TEST(FirstShape, WhatAFaceDoesIsToldFromWhoItIs) {
  const std::vector<float> identity = {1.2F, -0.8F};
  std::vector<float> expression(static_cast<std::size_t>(model().expression_count()), 0.0F);
  expression[0] = 0.8F;  // the jaw
  const FirstShape found = find_first_shape(model(), seen(identity, expression, 0.2));
  mesh::Vertices rest_mm;
  mesh::Vertices shown_mm;
  model().evaluate(identity, {}, rest_mm);
  model().evaluate(identity, expression, shown_mm);
  const auto apart = [](const mesh::Vertices& a, const mesh::Vertices& b) {
    return (a - b).colwise().norm().mean();
  };
  const double moved_mm = apart(shown_mm, rest_mm);
  const double person_mm = apart(rest_mm, mean_shape(model()).neutral_mm);
  ASSERT_GT(moved_mm, 0.3) << "there is something to tell";
  ASSERT_GT(person_mm, 0.3);
  EXPECT_LT(apart(found.shown_mm - found.neutral_mm, shown_mm - rest_mm), 0.5 * moved_mm);
  EXPECT_LT(apart(found.neutral_mm, rest_mm), 0.75 * person_mm);
  EXPECT_GT(found.expression[0], 0.4);
  EXPECT_LE(found.expression.maxCoeff(), 1.0);
  EXPECT_GE(found.expression.minCoeff(), 0.0) << "no face does less than nothing";
}

TEST(FirstShape, AThirdOfLandmarksMayBeWrong) {
  const std::vector<float> identity = {0.7F, 0.5F};
  std::vector<Correspondence> all = seen(identity, {}, 0.2);
  const FirstShape sound = find_first_shape(model(), all);
  for (std::size_t i = 0; i < all.size(); i += 3) {
    all[i].target_mm += Vector3d(40, 10, 60);
  }
  const FirstShape found = find_first_shape(model(), all);
  EXPECT_LT((found.shown_mm - sound.shown_mm).colwise().norm().mean(), 2.0);
}

TEST(FirstShape, AJawThatIsHeldIsFilledUpByWhatLiesAboveIt) {
  const auto jaw = static_cast<std::size_t>(
      std::find(model().expression_names.begin(), model().expression_names.end(), "jawOpen") -
      model().expression_names.begin());
  ASSERT_LT(jaw, model().expression_names.size());
  const std::vector<float> identity = {1.2F, -0.8F};
  std::vector<float> expression(static_cast<std::size_t>(model().expression_count()), 0.0F);
  expression[jaw] = 1;
  std::vector<Correspondence> all = seen(identity, expression, 0.2);
  std::vector<Correspondence> above = above_the_jaw(model(), all);
  EXPECT_LT(above.size(), all.size());
  EXPECT_GT(above.size(), all.size() / 4);
  const mesh::Vertices moves_mm = model().core_row(0, static_cast<int>(jaw) + 1);
  for (const Correspondence& one : above) {
    EXPECT_LE(face::FaceModel::anchor_point(one.anchor, moves_mm).norm(), 2.0F);
  }
  const FirstShape found = find_first_shape(model(), above, 1.25);
  EXPECT_EQ(found.expression[static_cast<Eigen::Index>(jaw)], 1.25) << "beyond what is looked for otherwise";
  mesh::Vertices rest_mm;
  model().evaluate(identity, {}, rest_mm);
  EXPECT_LT((found.neutral_mm - rest_mm).colwise().norm().mean(),
            (mean_shape(model()).neutral_mm - rest_mm).colwise().norm().mean());
}

TEST(FirstShape, WithoutLandmarksItIsTheMeanFace) {
  const FirstShape found = find_first_shape(model(), {});
  EXPECT_TRUE(found.shown_mm.isApprox(mean_shape(model()).neutral_mm, 1e-5F));
  EXPECT_EQ(found.expression.norm(), 0);
}

TEST(Place, TheExpressionIsNoPartOfTheRestShape) {
  const TemplateMesh surface = make_template(model(), 3000);
  FirstShape shape = mean_shape(model());
  shape.expression[1] = 1;
  shape.shown_mm = shape.neutral_mm + shape.deltas_mm[1];
  std::vector<float> expression(static_cast<std::size_t>(model().expression_count()), 0.0F);
  expression[1] = 1;
  std::vector<Correspondence> all = seen({}, expression, 0);
  const Placement placed = place(surface, shape, all);
  EXPECT_LT(placed.rms_mm, 1e-2);
  const Eigen::AngleAxisd turn(0.4, Vector3d(1, 3, -1).normalized());
  for (std::int32_t v = 0; v < surface.vertex_count(); v += 11) {
    const Vector3d rest = 1.04 * (turn * surface.neutral_mm.col(v).cast<double>()) + Vector3d(20, -15, 900);
    EXPECT_LT((placed.rest.vertices_mm.col(v).cast<double>() - rest).norm(), 0.05) << v;
    const Vector3d moved = 1.04 * (turn * surface.expressions_mm[1].col(v).cast<double>());
    EXPECT_LT((placed.shown_mm.col(v).cast<double>() - rest - moved).norm(), 0.05) << v;
  }
  EXPECT_EQ(placed.expression[1], 1);
}

}  // namespace
}  // namespace facet::fit
