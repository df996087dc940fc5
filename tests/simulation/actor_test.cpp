#include "simulation/actor.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "facet/error.hpp"
#include "render/renderer.hpp"
#include "simulation/wrinkles.hpp"
#include "support/synthetic_model.hpp"

namespace facet::simulation {
namespace {

const face::FaceModel& model() {
  static const face::FaceModel made = test::synthetic_model();
  return made;
}

const VirtualActor& actor() {
  static const VirtualActor made(model(), {.seed = 3});
  return made;
}

std::vector<float> expression(std::string_view name, float weight) {
  std::vector<float> weights(static_cast<std::size_t>(model().expression_count()), 0.0F);
  weights[static_cast<std::size_t>(model().expression_index(name))] = weight;
  return weights;
}

TEST(VirtualActor, IsFineEnoughAndPainted) {
  EXPECT_GT(actor().head_albedo().cols(), 90'000);
  EXPECT_TRUE(actor().head_albedo().allFinite());
  EXPECT_GT(actor().head_albedo().minCoeff(), 0);
  EXPECT_LT(actor().head_albedo().maxCoeff(), 1);
  EXPECT_LT(actor().head_triangles().maxCoeff(), actor().head_albedo().cols());
  EXPECT_TRUE(actor().glasses().vertices_mm.size() == 0);
  EXPECT_GT(VirtualActor(model(), {.seed = 3, .glasses = true}).glasses().vertices_mm.cols(), 1000);
}

TEST(VirtualActor, LiesOutsideTheModelsSpan) {
  EXPECT_GT(actor().outside_span_rms_mm(), 0.9F);
  EXPECT_LT(actor().outside_span_rms_mm(), 1.5F);
  // The same identity in the model and the actor at rest: their distance is about what was reported.
  ActorShape shape;
  actor().shape(std::vector<float>(static_cast<std::size_t>(model().expression_count()), 0.0F), {}, shape);
  mesh::Vertices inside_mm;
  model().evaluate(actor().identity(), {}, inside_mm);
  mesh::Triangles triangles(3, 2 * model().control.quads.cols());
  for (Eigen::Index q = 0; q < model().control.quads.cols(); ++q) {
    const auto quad = model().control.quads.col(q);
    triangles.col(2 * q) << quad[0], quad[1], quad[2];
    triangles.col(2 * q + 1) << quad[0], quad[2], quad[3];
  }
  const render::Raycaster caster(inside_mm, triangles);
  std::vector<float> distances;
  for (Eigen::Index v = 0; v < shape.head_mm.cols(); v += 50) {
    if (actor().face_skin()[v] > 0.99F) {
      distances.push_back(caster.closest_point(shape.head_mm.col(v), 30).distance_mm);
    }
  }
  ASSERT_GT(distances.size(), 100U);
  std::nth_element(distances.begin(), distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2),
                   distances.end());
  EXPECT_GT(distances[distances.size() / 2], 0.2F);
  EXPECT_LT(distances[distances.size() / 2], 2.0F);
}

TEST(VirtualActor, MovesWithTheExpression) {
  ActorShape rest;
  ActorShape open;
  actor().shape(expression("jawOpen", 0), {}, rest);
  actor().shape(expression("jawOpen", 1), {}, open);
  EXPECT_TRUE(open.head_mm.allFinite());
  EXPECT_TRUE(open.head_normals.allFinite());
  EXPECT_GT((open.head_mm - rest.head_mm).colwise().norm().maxCoeff(), 10);
  // The lower teeth go down with the chin, the upper ones are not part of the shape.
  EXPECT_LT((open.lower_teeth_mm - rest.lower_teeth_mm).row(1).mean(), -5);
}

TEST(VirtualActor, SeedsGiveDifferentPeople) {
  const VirtualActor other(model(), {.seed = 4});
  EXPECT_NE(other.identity(), actor().identity());
  EXPECT_FALSE(other.head_albedo().isApprox(actor().head_albedo(), 0.01F));
  const VirtualActor same(model(), {.seed = 3});
  EXPECT_EQ(same.identity(), actor().identity());
  EXPECT_EQ(same.head_albedo(), actor().head_albedo());
}

TEST(VirtualActor, NeedsLandmarks) {
  face::FaceModel without = test::synthetic_model(9);
  without.landmarks.clear();
  EXPECT_THROW(VirtualActor(without, {}), Error);
}

TEST(Wrinkles, DeepenWithTheirExpressionAndKeepTheirSize) {
  ActorShape rest;
  actor().shape(expression("browInnerUp", 0), {}, rest);
  const Eigen::VectorXf no_lips = Eigen::VectorXf::Zero(rest.head_mm.cols());
  const Wrinkles wrinkles(
      actor().anatomy(),
      {rest.head_mm, rest.head_normals, actor().head_triangles(), actor().face_skin(), no_lips}, 3,
      actor().expression_names());
  Eigen::VectorXf at_rest;
  Eigen::VectorXf raised;
  wrinkles.relief_mm(expression("browInnerUp", 0), at_rest);
  wrinkles.relief_mm(expression("browInnerUp", 1), raised);
  const float brow_y = actor().anatomy().brow[0].y();
  float deepest_at_rest = 0;
  float deepest_raised = 0;
  float elsewhere = 0;
  for (Eigen::Index v = 0; v < raised.size(); ++v) {
    const float y = rest.head_mm(1, v);
    if (y > brow_y + 6) {
      deepest_at_rest = std::min(deepest_at_rest, at_rest[v]);
      deepest_raised = std::min(deepest_raised, raised[v]);
    } else if (y < brow_y - 25) {
      elsewhere = std::max(elsewhere, std::abs(raised[v] - at_rest[v]));
    }
    if (actor().face_skin()[v] == 0) {
      EXPECT_EQ(raised[v], 0);
    }
  }
  EXPECT_LT(deepest_raised, deepest_at_rest - 0.15F);
  EXPECT_GT(deepest_raised, -1.2F);
  EXPECT_LT(elsewhere, 0.02F);  // a brow raise folds the forehead alone
  EXPECT_LT(at_rest.cwiseAbs().maxCoeff(), 1.0F);
}

}  // namespace
}  // namespace facet::simulation
