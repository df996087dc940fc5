#include "fit/template_mesh.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <random>

#include "facet/error.hpp"
#include "fit/first_shape.hpp"
#include "support/synthetic_model.hpp"

namespace facet::fit {
namespace {

using Eigen::Vector3d;

const face::FaceModel& model() {
  static const face::FaceModel made = test::synthetic_model();
  return made;
}

mesh::Vertices control_vertices() {
  mesh::Vertices control_mm;
  model().evaluate({}, {}, control_mm);
  return control_mm;
}

/// All landmarks, moved by a map of space.
std::vector<Correspondence> correspondences(const std::function<Vector3d(const Vector3d&)>& moved) {
  const mesh::Vertices control_mm = control_vertices();
  std::vector<Correspondence> made;
  for (const face::LandmarkAnchor& anchor : model().landmarks) {
    if (anchor.weights[0] + anchor.weights[1] + anchor.weights[2] > 0.5F) {
      made.push_back({anchor, moved(face::FaceModel::anchor_point(anchor, control_mm).cast<double>())});
    }
  }
  return made;
}

TEST(TemplateMesh, IsTheModelRefinedInWholeSweeps) {
  const TemplateMesh coarse = make_template(model(), 1);
  const TemplateMesh fine = make_template(model(), 6000);
  EXPECT_GT(fine.vertex_count(), coarse.vertex_count() * 3 / 2);
  EXPECT_LE(fine.vertex_count(), 6000);
  EXPECT_EQ(fine.from_control.row_count(), fine.vertex_count());
  EXPECT_EQ(fine.expressions_mm.size(), static_cast<std::size_t>(model().expression_count()));
  // The stencils rows sum to 1, so that a shift of the control mesh shifts the template.
  mesh::Vertices shifted;
  mesh::apply(fine.from_control, mesh::Vertices(control_vertices().colwise() + Eigen::Vector3f(3, -2, 5)),
              shifted);
  EXPECT_LT((shifted - (fine.neutral_mm.colwise() + Eigen::Vector3f(3, -2, 5))).cwiseAbs().maxCoeff(), 1e-3F);
  // An expression of the model is that of the template.
  std::vector<float> weights(static_cast<std::size_t>(model().expression_count()), 0.0F);
  weights[2] = 0.7F;
  mesh::Vertices control_mm;
  model().evaluate({}, weights, control_mm);
  mesh::Vertices smiling;
  mesh::apply(fine.from_control, control_mm, smiling);
  EXPECT_LT((smiling - (fine.neutral_mm + 0.7F * fine.expressions_mm[2])).cwiseAbs().maxCoeff(), 1e-3F);
}

TEST(Place, FollowsASimilarityAndSpreadsWhatIsLeft) {
  const TemplateMesh surface = make_template(model(), 3000);
  const Eigen::AngleAxisd turn(0.6, Vector3d(1, 2, -1).normalized());
  const auto moved = [&](const Vector3d& at) {
    return Vector3d(1.07 * (turn * at) + Vector3d(12, -30, 900));
  };
  const Placement placed = place(surface, mean_shape(model()), correspondences(moved));
  EXPECT_LT(placed.rms_mm, 1e-3);
  for (std::int32_t v = 0; v < surface.vertex_count(); v += 7) {
    EXPECT_LT(
        (placed.rest.vertices_mm.col(v).cast<double>() - moved(surface.neutral_mm.col(v).cast<double>()))
            .norm(),
        0.01);
  }
  // Expressions turn with it.
  EXPECT_LT((placed.rest.expressions_mm[1] -
             (1.07 * turn.toRotationMatrix()).cast<float>() * surface.expressions_mm[1])
                .cwiseAbs()
                .maxCoeff(),
            1e-3F);

  // A longer nose: what an affine map can't tell.
  const auto nosed = [&](const Vector3d& at) {
    return moved(at + Vector3d(0, 0, 6 * std::exp(-(at - Vector3d(0, -28, 50)).squaredNorm() / 800)));
  };
  const Placement spread = place(surface, mean_shape(model()), correspondences(nosed));
  double worst = 0;
  for (std::int32_t v = 0; v < surface.vertex_count(); ++v) {
    const Vector3d at = surface.neutral_mm.col(v).cast<double>();
    if ((at - Vector3d(0, -28, 50)).norm() < 25) {
      worst = std::max(worst, (spread.rest.vertices_mm.col(v).cast<double>() - nosed(at)).norm());
    }
  }
  EXPECT_LT(worst, 3.0) << "of 6";
}

TEST(Place, WrongLandmarksAreLeftOut) {
  const TemplateMesh surface = make_template(model(), 3000);
  const auto moved = [&](const Vector3d& at) { return Vector3d(at + Vector3d(0, 0, 900)); };
  std::vector<Correspondence> all = correspondences(moved);
  std::mt19937_64 random(7);
  std::normal_distribution<double> noise(0, 0.5);
  for (std::size_t i = 0; i < all.size(); ++i) {
    all[i].target_mm += Vector3d(noise(random), noise(random), noise(random));
    if (i % 5 == 0) {
      all[i].target_mm += Vector3d(60, -45, 80);
    }
  }
  const Placement placed = place(surface, mean_shape(model()), all);
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(placed.agrees[i], i % 5 == 0 ? 0 : 1) << i;
  }
  double sum = 0;
  for (std::int32_t v = 0; v < surface.vertex_count(); ++v) {
    sum += (placed.rest.vertices_mm.col(v).cast<double>() - moved(surface.neutral_mm.col(v).cast<double>()))
               .norm();
  }
  EXPECT_LT(sum / surface.vertex_count(), 1.0);
}

TEST(Place, SaysWhatIsMissing) {
  const TemplateMesh surface = make_template(model(), 1);
  std::vector<Correspondence> all = correspondences([](const Vector3d& at) { return at; });
  all.resize(5);
  EXPECT_THAT([&] { place(surface, mean_shape(model()), all); },
              ::testing::ThrowsMessage<Error>(
                  ::testing::HasSubstr("5 of 5 landmarks agree with each other, at least 6 must")));
  std::vector<Correspondence> line(12, all.front());
  EXPECT_THAT([&] { place(surface, mean_shape(model()), line); },
              ::testing::ThrowsMessage<Error>(::testing::HasSubstr("lie on a line")));
}

TEST(AlignRigidly, FindsTheMotionAndTheScale) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  Eigen::Matrix3Xd from(3, 20);
  for (Eigen::Index i = 0; i < from.size(); ++i) {
    from.data()[i] = 50 * normal(random);
  }
  const Eigen::Isometry3d motion =
      Eigen::Translation3d(1, 2, 3) * Eigen::AngleAxisd(2.5, Vector3d(1, -1, 0.5).normalized());
  double scale = 0;
  const Eigen::Matrix3Xd to = (motion.linear() * (0.8 * from)).colwise() + motion.translation();
  const Eigen::Isometry3d found = align_rigidly(from, to, Eigen::VectorXd::Ones(20), &scale);
  EXPECT_NEAR(scale, 0.8, 1e-12);
  EXPECT_LT((found.matrix() - motion.matrix()).norm(), 1e-9);
}

}  // namespace
}  // namespace facet::fit
