#include "face/face_model.hpp"

#include <gtest/gtest.h>

#include <random>

#include "support/synthetic_model.hpp"

namespace facet::face {
namespace {

constexpr unsigned kSeed = 20191122;

std::vector<float> random_weights(std::mt19937& random, int count, float low, float high) {
  std::uniform_real_distribution<float> uniform(low, high);
  std::vector<float> weights(static_cast<std::size_t>(count));
  for (float& weight : weights) {
    weight = uniform(random);
  }
  return weights;
}

/// C x2 w_id x3 w_exp written out number by number, in double.
Eigen::Matrix3Xd obvious_evaluate(const FaceModel& model, const std::vector<float>& identity,
                                  const std::vector<float>& expression) {
  Eigen::Matrix3Xd sum = Eigen::Matrix3Xd::Zero(3, model.vertex_count());
  std::size_t at = 0;
  for (int i = 0; i < model.identity_modes; ++i) {
    for (int e = 0; e < model.expression_modes; ++e) {
      const double w_id = i == 0 ? 1.0 : static_cast<double>(identity[static_cast<std::size_t>(i - 1)]);
      const double w_exp = e == 0 ? 1.0 : static_cast<double>(expression[static_cast<std::size_t>(e - 1)]);
      for (int v = 0; v < model.vertex_count(); ++v) {
        for (int axis = 0; axis < 3; ++axis) {
          sum(axis, v) += w_id * w_exp * static_cast<double>(model.core_mm[at++]);
        }
      }
    }
  }
  return sum;
}

TEST(FaceModel, EvaluatesTheBilinearCore) {
  SCOPED_TRACE(kSeed);
  std::mt19937 random(kSeed);
  const FaceModel model = test::synthetic_model(13);
  for (int trial = 0; trial < 5; ++trial) {
    const auto identity = random_weights(random, model.identity_count(), -2, 2);
    const auto expression = random_weights(random, model.expression_count(), 0, 1);
    const Eigen::Matrix3Xd expected = obvious_evaluate(model, identity, expression);
    mesh::Vertices vertices_mm;
    model.evaluate(identity, expression, vertices_mm);
    // 42 float sums of values up to 100 mm.
    EXPECT_LT((vertices_mm.cast<double>() - expected).cwiseAbs().maxCoeff(), 1e-3);

    mesh::Vertices through_basis_mm;
    model.contract_identity(identity).evaluate(expression, through_basis_mm);
    EXPECT_LT((through_basis_mm.cast<double>() - expected).cwiseAbs().maxCoeff(), 1e-3);
  }
}

TEST(FaceModel, MissingTrailingWeightsCountAsZero) {
  const FaceModel model = test::synthetic_model(13);
  const std::vector<float> some = {0.5F, -1.0F};
  std::vector<float> all(static_cast<std::size_t>(model.identity_count()), 0.0F);
  all[0] = some[0];
  all[1] = some[1];
  mesh::Vertices a_mm;
  mesh::Vertices b_mm;
  model.evaluate(some, {}, a_mm);
  model.evaluate(all, std::vector<float>(static_cast<std::size_t>(model.expression_count()), 0.0F), b_mm);
  EXPECT_EQ(a_mm, b_mm);
  model.contract_identity(some).evaluate({}, a_mm);
  EXPECT_LT((a_mm - b_mm).cwiseAbs().maxCoeff(), 1e-4F);
}

TEST(FaceModel, ExpressionsOfTwoPeopleDiffer) {
  const FaceModel model = test::synthetic_model(13);
  const ExpressionBasis mean = model.contract_identity({});
  const ExpressionBasis other = model.contract_identity(std::vector<float>{2.0F});
  for (std::size_t e = 0; e < mean.deltas_mm.size(); ++e) {
    EXPECT_GT((mean.deltas_mm[e] - other.deltas_mm[e]).cwiseAbs().maxCoeff(), 0.05F) << e;
  }
}

TEST(FaceModel, CoreAtLandmarksEqualsTheAnchorOnTheMesh) {
  std::mt19937 random(kSeed);
  const FaceModel model = test::synthetic_model(13);
  const std::vector<int> indices = {0, 1, 33, 263, 467, 152};
  const auto cores = model.core_at(indices);
  ASSERT_EQ(cores.size(), indices.size());
  const auto identity = random_weights(random, model.identity_count(), -2, 2);
  const auto expression = random_weights(random, model.expression_count(), 0, 1);
  Eigen::VectorXf w_id(model.identity_modes);
  Eigen::VectorXf w_exp(model.expression_modes);
  w_id[0] = w_exp[0] = 1;
  std::copy(identity.begin(), identity.end(), w_id.data() + 1);
  std::copy(expression.begin(), expression.end(), w_exp.data() + 1);
  mesh::Vertices vertices_mm;
  model.evaluate(identity, expression, vertices_mm);
  for (std::size_t k = 0; k < indices.size(); ++k) {
    const Eigen::VectorXf per_mode = cores[k] * w_exp;
    const Eigen::Vector3f point_mm = per_mode.reshaped(3, model.identity_modes) * w_id;
    const Eigen::Vector3f expected_mm =
        FaceModel::anchor_point(model.landmarks[static_cast<std::size_t>(indices[k])], vertices_mm);
    EXPECT_LT((point_mm - expected_mm).norm(), 1e-3F) << indices[k];
  }
}

TEST(FaceModel, LandmarkWithoutAPlaceHasAZeroCore) {
  FaceModel model = test::synthetic_model(13);
  model.landmarks[5] = {};
  EXPECT_EQ(model.check(), "");
  EXPECT_TRUE(model.core_at(std::vector<int>{5})[0].isZero());
}

TEST(FaceModel, FindsExpressionsByName) {
  const FaceModel model = test::synthetic_model(13);
  EXPECT_EQ(model.expression_index("jawOpen"), 0);
  EXPECT_EQ(model.expression_index("browInnerUp"), 5);
  EXPECT_EQ(model.expression_index("tongueOut"), -1);
}

TEST(FaceModel, CheckNamesWhatIsWrong) {
  const FaceModel good = test::synthetic_model(13);
  EXPECT_EQ(good.check(), "");
  const auto wrong = [&](auto change) {
    FaceModel model = good;
    change(model);
    return model.check();
  };
  EXPECT_NE(wrong([](FaceModel& m) { m.control.quads(0, 3) = m.control.vertex_count; }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.control.quads(0, 3) = -1; }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.core_mm[7] = std::nanf(""); }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.core_mm.pop_back(); }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.regions.pop_back(); }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.mean_albedo(0, 0) = INFINITY; }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.expression_names[1] = m.expression_names[0]; }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.expression_sigma[0] = 0; }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.expression_sigma.pop_back(); }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.landmarks.pop_back(); }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.landmarks[3].weights[0] += 0.1F; }), "");
  EXPECT_NE(wrong([](FaceModel& m) { m.landmarks[3].vertices[0] = m.control.vertex_count; }), "");
  EXPECT_NE(wrong([](FaceModel& m) { ++m.identity_modes; }), "");
}

}  // namespace
}  // namespace facet::face
