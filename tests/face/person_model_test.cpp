#include "face/person_model.hpp"

#include <gtest/gtest.h>

#include "face/subject_builder.hpp"
#include "support/synthetic_model.hpp"

namespace facet::face {
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

TEST(PersonModel, ASubjectBringsItsOwnFaceAlong) {
  const FaceModel model = test::synthetic_model(21);
  const std::vector<float> identity(static_cast<std::size_t>(model.identity_count()), 0.4F);
  mesh::Subject subject;
  subject.identity = identity;
  const ExpressionBasis of_the_model = model.contract_identity(identity);
  EXPECT_EQ(expressions_of(model, subject).neutral_mm, of_the_model.neutral_mm);

  Eigen::Matrix3Xd larger = of_the_model.neutral_mm.cast<double>();
  larger.row(0) *= 1.1;
  const FaceModel person = person_model(model, identity, larger, "wide");
  mesh::MeshFrame first;
  first.control_vertices_mm = larger.cast<float>();
  first.camera_from_head.linear() = Eigen::Vector3f(1, -1, -1).asDiagonal();
  first.camera_from_head.translation() << 0, 0, 600;
  first.camera = {800, 800, 320, 240, 640, 480};
  const auto built = build_subject(person, {}, first, {}, 1);
  EXPECT_EQ(built->identity, identity);
  ASSERT_EQ(built->neutral_mm.cols(), model.vertex_count());
  const ExpressionBasis own = expressions_of(model, *built);
  EXPECT_LT((own.neutral_mm - larger.cast<float>()).cwiseAbs().maxCoeff(), 1e-4F);
  const ExpressionBasis by_itself = expressions_of(person, *built);
  ASSERT_EQ(own.deltas_mm.size(), by_itself.deltas_mm.size());
  for (std::size_t e = 0; e < own.deltas_mm.size(); ++e) {
    EXPECT_LT((own.deltas_mm[e] - by_itself.deltas_mm[e]).cwiseAbs().maxCoeff(), 1e-3F)
        << model.expression_names[e];
  }
  // Of another model: no expressions are made up for it.
  subject = *built;
  subject.identity.pop_back();
  EXPECT_TRUE(expressions_of(model, subject).deltas_mm.empty());
}

}  // namespace
}  // namespace facet::face
