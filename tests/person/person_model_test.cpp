#include "person/person_model.hpp"

#include <gtest/gtest.h>

#include "support/synthetic_model.hpp"

namespace facet::person {
namespace {

TEST(PersonModel, IsTheModelOfOneFaceWithItsExpressions) {
  const face::FaceModel model = test::synthetic_model(21);
  const std::vector<float> identity(static_cast<std::size_t>(model.identity_count()), 0.5F);
  const face::ExpressionBasis basis = model.contract_identity(identity);
  const face::FaceModel person = person_model(model, identity, basis.neutral_mm.cast<double>(), "Ada");
  EXPECT_EQ(person.check(), "");
  EXPECT_EQ(person.identity_count(), 0);
  EXPECT_EQ(person.name, "Ada");
  EXPECT_EQ(person.expression_names, model.expression_names);
  mesh::Vertices vertices_mm;
  person.evaluate({}, {}, vertices_mm);
  EXPECT_LT((vertices_mm - basis.neutral_mm).cwiseAbs().maxCoeff(), 1e-4F);
  // On the face that it was found from nothing changes: the transfer onto itself.
  for (std::size_t e = 0; e < basis.deltas_mm.size(); ++e) {
    const float size = basis.deltas_mm[e].colwise().norm().maxCoeff();
    EXPECT_LT((person.core_row(0, static_cast<int>(e) + 1) - basis.deltas_mm[e]).colwise().norm().maxCoeff(),
              0.06F * size)
        << model.expression_names[e];
  }
}

TEST(PersonModel, ExpressionsGrowWithTheFace) {
  const face::FaceModel model = test::synthetic_model(21);
  const std::vector<float> identity(static_cast<std::size_t>(model.identity_count()));
  const face::ExpressionBasis basis = model.contract_identity(identity);
  const Eigen::Matrix3Xd larger = 1.2 * basis.neutral_mm.cast<double>();
  const face::FaceModel person = person_model(model, identity, larger, "large");
  const int jaw = model.expression_index("jawOpen");
  const float before = basis.deltas_mm[static_cast<std::size_t>(jaw)].colwise().norm().maxCoeff();
  const float after = person.core_row(0, jaw + 1).colwise().norm().maxCoeff();
  EXPECT_NEAR(after / before, 1.2F, 0.06F);
}

}  // namespace
}  // namespace facet::person
