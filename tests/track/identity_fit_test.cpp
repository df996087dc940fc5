#include "track/identity_fit.hpp"

#include <gtest/gtest.h>

#include <array>

#include "derivative_check.hpp"
#include "support/synthetic_model.hpp"
#include "synthetic_landmarks.hpp"

namespace facet::track {
namespace {

class IdentityFitTest : public testing::Test {
 protected:
  IdentityFitTest()
      : face_model(test::synthetic_model()),
        model(face_model),
        prior(face_model.expression_names, face_model.expression_sigma, {}, model.sees_gaze()) {}

  /// A batch of `count` views of one person, started from the truth's pose and a neutral expression.
  IdentityFit batch(const Eigen::VectorXd& identity, int count, double noise_px, double fixed_focal_px,
                    const IdentityPriorStrength& strength) {
    test::SyntheticView any;
    IdentityFit fit(model, prior, {}, strength, any.width_px, fixed_focal_px,
                    {{.centre_px = any.centre_px()}});
    for (int f = 0; f < count; ++f) {
      auto view = test::random_view(model, identity, random, 0.5);
      view.focal_px = 1000;
      const auto face = test::synthetic_landmarks(model, view, noise_px, random);
      const landmark::FaceLandmarks* const faces = &face;
      fit.add_frame({&faces, 1}, {view.pose, Eigen::VectorXd::Zero(model.expression_count())});
    }
    return fit;
  }

  static void add(IdentityFit& fit, const landmark::FaceLandmarks& face, const FrameState& start) {
    const landmark::FaceLandmarks* const shown = &face;
    fit.add_frame({&shown, 1}, start);
  }

  std::mt19937 random{30};
  face::FaceModel face_model;
  LandmarkModel model;
  ExpressionPrior prior;
};

TEST_F(IdentityFitTest, GradientMatchesDifferences) {
  IdentityFit fit = batch(test::random_identity(model, random), 3, 1.0, 0, {});
  std::normal_distribution<double> normal;
  Eigen::VectorXd start =
      0.05 * Eigen::VectorXd::NullaryExpr(fit.gradient().size(), [&] { return normal(random); });
  const int own = kExpressionAt + model.expression_count();
  for (int f = 0; f < 3; ++f) {
    start.segment(f * own + kExpressionAt, model.expression_count()).setConstant(0.4);  // off the bounds
  }
  fit.move(start);
  const Eigen::VectorXd gradient = fit.gradient();
  const auto energy_at = [&](int i, double h) {
    const Eigen::VectorXd step = h * Eigen::VectorXd::Unit(gradient.size(), i);
    fit.move(step);
    const double energy = fit.energy();
    fit.move(-step);
    return energy;
  };
  EXPECT_LT(test::gradient_error(gradient, energy_at), 2e-6);
  Eigen::VectorXd wrong = gradient;
  wrong[gradient.size() - 2] += 0.01 * gradient.cwiseAbs().maxCoeff();
  EXPECT_GT(test::gradient_error(wrong, energy_at), 1e-3) << "the checker can't fail";
}

TEST_F(IdentityFitTest, EvidenceIsPartOfTheEnergy) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  IdentityFit fit = batch(Eigen::VectorXd::Zero(model.identity_count()), 3, 0.5, 1000, {});
  const Eigen::Index count = identity.size();
  fit.set_evidence({Eigen::MatrixXd::Identity(count, count) * 40 + Eigen::MatrixXd::Ones(count, count),
                    Eigen::VectorXd::Constant(count, 2.0), identity});
  std::normal_distribution<double> normal;
  fit.move(0.05 * Eigen::VectorXd::NullaryExpr(fit.gradient().size(), [&] { return normal(random); }));
  const Eigen::VectorXd gradient = fit.gradient();
  const auto energy_at = [&](int i, double h) {
    const Eigen::VectorXd step = h * Eigen::VectorXd::Unit(gradient.size(), i);
    fit.move(step);
    const double energy = fit.energy();
    fit.move(-step);
    return energy;
  };
  const Eigen::Index first = gradient.size() - count - 1;
  double worst = 0;
  for (Eigen::Index i = first; i < first + count; ++i) {
    const double numeric =
        (energy_at(static_cast<int>(i), 1e-6) - energy_at(static_cast<int>(i), -1e-6)) / 2e-6;
    worst = std::max(worst, std::abs(numeric - gradient[i]) / gradient.cwiseAbs().maxCoeff());
  }
  EXPECT_LT(worst, 2e-6);
  // Evidence that outweighs the landmarks is what is found.
  fit.set_evidence({Eigen::MatrixXd::Identity(count, count) * 1e9, Eigen::VectorXd::Zero(count), identity});
  fit.improve(30);
  EXPECT_LT((fit.shape().identity - identity).cwiseAbs().maxCoeff(), 1e-3);
}

TEST_F(IdentityFitTest, FindsIdentityAndFocalLengthTogether) {
  const Eigen::VectorXd identity = test::random_identity(model, random);
  IdentityPriorStrength weak;
  weak.identity = 1e-3;
  weak.log_focal_sigma = 10;
  IdentityFit fit = batch(identity, 10, 0.0, 0, weak);
  double before = std::numeric_limits<double>::infinity();
  for (int call = 0; call < 20; ++call) {
    const CoarseFitReport report = fit.improve(5);
    ASSERT_NE(report.outcome, CoarseFitOutcome::NumericalFailure);
    ASSERT_LE(report.final_energy, report.initial_energy);
    before = report.final_energy;
  }
  EXPECT_TRUE(std::isfinite(before));
  EXPECT_LT((fit.shape().identity - identity).cwiseAbs().maxCoeff(), 0.25);
  EXPECT_NEAR(fit.shape().focal_px, 1000, 60);
  EXPECT_LT(fit.landmark_bias_mm().cwiseAbs().maxCoeff(), 0.5);
}

TEST_F(IdentityFitTest, KnownFocalLengthIsHeld) {
  IdentityFit fit = batch(test::random_identity(model, random), 5, 0.5, 1000, {});
  fit.improve(30);
  EXPECT_NEAR(fit.shape().focal_px, 1000, 1e-6);
}

TEST_F(IdentityFitTest, PersistentOffsetsBecomeBias) {
  // The net sees one landmark 3 mm off on every frame of this face: that is no identity and no expression.
  const Eigen::VectorXd identity = Eigen::VectorXd::Zero(model.identity_count());
  test::SyntheticView any;
  IdentityFit fit(model, prior, {}, {}, any.width_px, any.focal_px, {{.centre_px = any.centre_px()}});
  const int landmark = model.landmarks()[200];
  for (int f = 0; f < 12; ++f) {
    const auto view = test::random_view(model, identity, random, 0.2);
    auto face = test::synthetic_landmarks(model, view, 0.2, random);
    const double px_per_mm = view.focal_px / view.pose.translation_mm.z();
    face.points_px(0, landmark) += static_cast<float>(3.0 * px_per_mm);
    add(fit, face, {view.pose, view.expression});
  }
  fit.improve(30);
  const Eigen::VectorXd bias = fit.landmark_bias_mm();
  EXPECT_NEAR(bias[3 * 200], 3.0, 0.9);
  EXPECT_NEAR(bias[3 * 200 + 1], 0.0, 0.5);
  EXPECT_LT(bias.segment<3>(3 * 100).norm(), 0.5);
}

TEST_F(IdentityFitTest, TwoViewsAreOneEnergy) {
  test::SyntheticView any;
  const FurtherCamera side = test::side_view(any, 0.4);
  IdentityFit fit(model, prior, {}, {}, any.width_px, any.focal_px,
                  {{.centre_px = any.centre_px()}, test::camera_of(side, any)});
  const Eigen::VectorXd identity = test::random_identity(model, random);
  for (int f = 0; f < 3; ++f) {
    const auto view = test::random_view(model, identity, random, 0.3);
    const auto front = test::synthetic_landmarks(model, view, 0.5, random);
    const auto aside = test::synthetic_landmarks(model, test::seen_by(side, view), 0.5, random);
    const std::array<const landmark::FaceLandmarks*, 2> both = {&front, f == 1 ? nullptr : &aside};
    fit.add_frame(both, {view.pose, Eigen::VectorXd::Constant(model.expression_count(), 0.4)});
  }
  std::normal_distribution<double> normal;
  fit.move(0.05 * Eigen::VectorXd::NullaryExpr(fit.gradient().size(), [&] { return normal(random); }));
  const Eigen::VectorXd gradient = fit.gradient();
  const auto energy_at = [&](int i, double h) {
    const Eigen::VectorXd step = h * Eigen::VectorXd::Unit(gradient.size(), i);
    fit.move(step);
    const double energy = fit.energy();
    fit.move(-step);
    return energy;
  };
  EXPECT_LT(test::gradient_error(gradient, energy_at), 2e-6);
}

TEST_F(IdentityFitTest, AnEmptyBatchIsAFailureNotACrash) {
  test::SyntheticView any;
  IdentityFit fit(model, prior, {}, {}, any.width_px, 0, {{.centre_px = any.centre_px()}});
  EXPECT_EQ(fit.improve(3).outcome, CoarseFitOutcome::NumericalFailure);
}

}  // namespace
}  // namespace facet::track
