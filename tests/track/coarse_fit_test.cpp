#include "track/coarse_fit.hpp"

#include <gtest/gtest.h>

#include <array>
#include <filesystem>

#include "derivative_check.hpp"
#include "support/paths.hpp"
#include "support/synthetic_model.hpp"
#include "synthetic_landmarks.hpp"

namespace facet::track {
namespace {

/// Agreement of an analytic derivative with central differences of step 1e-6 in double precision.
constexpr double kDerivativeTolerance = 2e-6;

class CoarseFitTest : public testing::Test {
 protected:
  CoarseFitTest()
      : face_model(test::synthetic_model()),
        model(face_model),
        prior(face_model.expression_names, face_model.expression_sigma, {}, model.sees_gaze()),
        fit(model, prior, trust, {}) {}

  Observation observation_of(const test::SyntheticView& view, const landmark::FaceLandmarks& face) const {
    Observation observation;
    observe(model, trust, face, view.pose.translation_mm, view.focal_px, {.centre_px = view.centre_px()},
            observation);
    return observation;
  }

  /// A state some way off the truth.
  FrameState disturbed(const test::SyntheticView& view) {
    std::uniform_real_distribution<double> unit(-1, 1);
    FrameState state{view.pose, view.expression};
    state.pose.rotation =
        rotation_from_vector(0.1 * Eigen::Vector3d(unit(random), unit(random), unit(random))) *
        state.pose.rotation;
    state.pose.translation_mm += Eigen::Vector3d(8 * unit(random), 8 * unit(random), 40 * unit(random));
    for (double& weight : state.expression) {
      weight = std::clamp(weight + 0.2 * unit(random), 0.05, 0.95);
    }
    return state;
  }

  std::mt19937 random{20};
  face::FaceModel face_model;
  LandmarkModel model;
  LandmarkTrust trust;
  ExpressionPrior prior;
  CoarseFit fit;
};

TEST_F(CoarseFitTest, GradientMatchesDifferences) {
  for (int round = 0; round < 5; ++round) {
    const auto view = test::random_view(model, test::random_identity(model, random), random);
    const auto face = test::synthetic_landmarks(model, view, 1.0, random);
    const Observation observation = observation_of(view, face);
    LandmarkBasis basis;
    model.contract_identity(view.identity, basis);
    const FrameState state = disturbed(view);
    const TemporalPrior previous{disturbed(view), 0.04};
    NormalEquations equations(kExpressionAt + model.expression_count());
    const double energy = fit.linearise(basis, {&observation, 1}, 880, &previous, state, equations);
    EXPECT_NEAR(energy, fit.energy(basis, {&observation, 1}, 880, &previous, state), 1e-9 * energy);
    const auto energy_at = [&](int i, double h) {
      FrameState moved;
      apply_step(state, h * Eigen::VectorXd::Unit(equations.unknown_count(), i), moved);
      return fit.energy(basis, {&observation, 1}, 880, &previous, moved);
    };
    EXPECT_LT(test::gradient_error(equations.gradient, energy_at), kDerivativeTolerance);

    // The checker can fail: one entry off by one per cent of the largest is seen.
    Eigen::VectorXd wrong = equations.gradient;
    wrong[round] += 0.01 * wrong.cwiseAbs().maxCoeff();
    EXPECT_GT(test::gradient_error(wrong, energy_at), 100 * kDerivativeTolerance);
  }
}

TEST_F(CoarseFitTest, GradientOfTwoViewsMatchesDifferences) {
  const auto view = test::random_view(model, test::random_identity(model, random), random);
  const FurtherCamera side = test::side_view(view, -0.4);
  std::array<Observation, 2> views;
  views[0] = observation_of(view, test::synthetic_landmarks(model, view, 1.0, random));
  observe(model, trust, test::synthetic_landmarks(model, test::seen_by(side, view), 1.0, random),
          view.pose.translation_mm, view.focal_px, test::camera_of(side, view), views[1]);
  LandmarkBasis basis;
  model.contract_identity(view.identity, basis);
  const FrameState state = disturbed(view);
  NormalEquations equations(kExpressionAt + model.expression_count());
  const double energy = fit.linearise(basis, views, view.focal_px, nullptr, state, equations);
  const auto energy_at = [&](int i, double h) {
    FrameState moved;
    apply_step(state, h * Eigen::VectorXd::Unit(equations.unknown_count(), i), moved);
    return fit.energy(basis, views, view.focal_px, nullptr, moved);
  };
  EXPECT_LT(test::gradient_error(equations.gradient, energy_at), kDerivativeTolerance);

  // A view that shows nothing says nothing, wherever its camera stands.
  views[1].seen = false;
  views[1].camera.view_from_reference.translation().z() = -5000;
  const double alone = fit.energy(basis, {&views[0], 1}, view.focal_px, nullptr, state);
  EXPECT_EQ(fit.energy(basis, views, view.focal_px, nullptr, state), alone);
  EXPECT_LT(alone, energy);
}

TEST_F(CoarseFitTest, HessianMatchesDifferencesWhereTheResidualsVanish) {
  // Gauss-Newton's matrix is the Hessian of the data term at zero residual.
  const auto view = test::random_view(model, test::random_identity(model, random), random);
  const auto face = test::synthetic_landmarks(model, view, 0.0, random);
  const Observation observation = observation_of(view, face);
  LandmarkBasis basis;
  model.contract_identity(view.identity, basis);
  FrameState state{view.pose, view.expression.cwiseMax(0.1)};
  Observation exact = observation;
  Eigen::Matrix2Xd residuals;
  ASSERT_TRUE(fit.landmark_term().residuals_px(basis, exact, view.focal_px, state, true, residuals));
  exact.points_px += residuals;
  NormalEquations at(kExpressionAt + model.expression_count());
  LandmarkTerm& term = fit.landmark_term();
  term.linearise(basis, exact, view.focal_px, state, nullptr, at);
  at.finish();
  constexpr double h = 1e-5;
  for (int i = 0; i < at.unknown_count(); ++i) {
    FrameState plus, minus;
    apply_step(state, h * Eigen::VectorXd::Unit(at.unknown_count(), i), plus);
    apply_step(state, -h * Eigen::VectorXd::Unit(at.unknown_count(), i), minus);
    NormalEquations up(at.unknown_count()), down(at.unknown_count());
    term.linearise(basis, exact, view.focal_px, plus, nullptr, up);
    up.finish();
    term.linearise(basis, exact, view.focal_px, minus, nullptr, down);
    down.finish();
    const Eigen::VectorXd numeric = (up.gradient - down.gradient) / (2 * h);
    EXPECT_LT((numeric - at.hessian.col(i)).norm(), 1e-3 * at.hessian.col(i).norm()) << "unknown " << i;
  }
}

TEST(Gaze, IsReadFromTheIrises) {
  if (!std::filesystem::exists(test::assets() / "default.facemodel")) {
    GTEST_SKIP() << "no default.facemodel (packaging/prepare)";
  }
  const auto face_model = face::FaceModel::load(test::assets() / "default.facemodel");
  const LandmarkModel model(face_model);
  ASSERT_TRUE(model.sees_gaze());
  const ExpressionPrior prior(face_model.expression_names, face_model.expression_sigma, {}, true);
  CoarseFit fit(model, prior, {}, {});
  std::mt19937 random(7);
  auto view = test::random_view(model, Eigen::VectorXd::Zero(model.identity_count()), random, 0.3);
  const auto weight = [&](FrameState& state, const std::string& name) -> double& {
    return state.expression[face_model.expression_index(name)];
  };
  for (const double aside : {0.5, -0.5}) {
    FrameState truth{view.pose, Eigen::VectorXd::Zero(model.expression_count())};
    weight(truth, aside > 0 ? "eyeLookOutLeft" : "eyeLookInLeft") = std::abs(aside);
    weight(truth, aside > 0 ? "eyeLookInRight" : "eyeLookOutRight") = std::abs(aside);
    view.expression = truth.expression;
    auto face = test::synthetic_landmarks(model, view, 0.3, random);
    for (const bool seen : {true, false}) {
      face.iris_confidence = {seen ? 1.0F : 0.0F, seen ? 1.0F : 0.0F};
      Observation observation;
      observe(model, {}, face, view.pose.translation_mm, view.focal_px, {.centre_px = view.centre_px()},
              observation);
      LandmarkBasis basis;
      model.contract_identity(view.identity, basis);
      FrameState state{view.pose, Eigen::VectorXd::Zero(model.expression_count())};
      fit.solve(basis, {&observation, 1}, view.focal_px, nullptr, 25, state);
      const double left = weight(state, "eyeLookOutLeft") - weight(state, "eyeLookInLeft");
      const double right = weight(state, "eyeLookInRight") - weight(state, "eyeLookOutRight");
      EXPECT_NEAR(left, seen ? aside : 0.0, 0.12) << "seen " << seen;
      EXPECT_NEAR(right, seen ? aside : 0.0, 0.12) << "seen " << seen;
    }
  }
}

TEST_F(CoarseFitTest, FindsPoseAndExpressionFromAfar) {
  // Priors off: what is measured exactly must come out exactly.
  ExpressionPrior flat(face_model.expression_names, face_model.expression_sigma, {0, 0, 0, 0},
                       model.sees_gaze());
  CoarseFit exact(model, flat, trust, {});
  for (int round = 0; round < 10; ++round) {
    const auto view = test::random_view(model, test::random_identity(model, random), random);
    const auto face = test::synthetic_landmarks(model, view, 0.0, random);
    const Observation observation = observation_of(view, face);
    LandmarkBasis basis;
    model.contract_identity(view.identity, basis);
    FrameState state = disturbed(view);
    const CoarseFitReport report = exact.solve(basis, {&observation, 1}, view.focal_px, nullptr, 40, state);
    EXPECT_EQ(report.outcome, CoarseFitOutcome::Converged);
    EXPECT_LT(vector_from_rotation(state.pose.rotation * view.pose.rotation.transpose()).norm(), 1e-3);
    EXPECT_LT((state.pose.translation_mm - view.pose.translation_mm).norm(), 0.5);
    EXPECT_LT((state.expression - view.expression).cwiseAbs().maxCoeff(), 0.01);
  }
}

TEST_F(CoarseFitTest, EndsInAMinimumWithinTheBounds) {
  // Karush-Kuhn-Tucker: the numeric gradient vanishes for free unknowns and points outwards at the bounds.
  int at_bound = 0;
  for (int round = 0; round < 10; ++round) {
    const auto view = test::random_view(model, test::random_identity(model, random), random);
    const auto face = test::synthetic_landmarks(model, view, 2.0, random);
    const Observation observation = observation_of(view, face);
    LandmarkBasis basis;
    model.contract_identity(Eigen::VectorXd::Zero(model.identity_count()), basis);
    FrameState state = disturbed(view);
    for (int call = 0; call < 4; ++call) {
      fit.solve(basis, {&observation, 1}, view.focal_px, nullptr, 100, state);
    }
    NormalEquations equations(kExpressionAt + model.expression_count());
    const double energy = fit.linearise(basis, {&observation, 1}, view.focal_px, nullptr, state, equations);
    // A step along the gradient that the curvature allows would gain less than this part of the energy.
    constexpr double kGainLeft = 1e-3;
    for (int i = 0; i < equations.unknown_count(); ++i) {
      const double g = equations.gradient[i];
      if (i >= kExpressionAt) {
        const double weight = state.expression[i - kExpressionAt];
        ASSERT_GE(weight, 0.0);
        ASSERT_LE(weight, 1.0);
        if ((weight <= 0.0 && g >= 0) || (weight >= 1.0 && g <= 0)) {
          ++at_bound;
          continue;
        }
      }
      EXPECT_LT(0.5 * g * g / equations.hessian(i, i), kGainLeft * energy) << "unknown " << i;
    }
  }
  EXPECT_GT(at_bound, 0) << "no bound was active: the test does not test them";
}

TEST_F(CoarseFitTest, WildLandmarksAreOutvoted) {
  const auto view = test::random_view(model, test::random_identity(model, random), random);
  auto face = test::synthetic_landmarks(model, view, 0.3, random);
  for (int i = 0; i < landmark::landmark_count; i += 10) {
    face.points_px.col(i) += Eigen::Vector3f(45, -30, 0);
  }
  const Observation observation = observation_of(view, face);
  LandmarkBasis basis;
  model.contract_identity(view.identity, basis);
  FrameState robust = disturbed(view);
  FrameState plain = robust;
  fit.solve(basis, {&observation, 1}, view.focal_px, nullptr, 40, robust);
  LandmarkTrust trusting = trust;
  trusting.huber_sigmas = 1e6;
  CoarseFit least_squares(model, prior, trusting, {});
  least_squares.solve(basis, {&observation, 1}, view.focal_px, nullptr, 40, plain);
  const auto error_mm = [&](const FrameState& state) {
    return (state.pose.translation_mm - view.pose.translation_mm).head<2>().norm();
  };
  EXPECT_LT(error_mm(robust), 1.0);
  EXPECT_LT(error_mm(robust), 0.5 * error_mm(plain));
}

TEST_F(CoarseFitTest, TemporalPriorHoldsJitterAndLetsMovementPass) {
  const auto view = test::random_view(model, test::random_identity(model, random), random);
  LandmarkBasis basis;
  model.contract_identity(view.identity, basis);
  // The same face measured thirty times with noise: successive frames differ less with the prior.
  const auto jitter = [&](bool use_prior) {
    std::mt19937 noise(5);
    TemporalPrior previous{{view.pose, view.expression}, 0.04};
    double sum = 0;
    for (int frame = 0; frame < 30; ++frame) {
      const Observation observation =
          observation_of(view, test::synthetic_landmarks(model, view, 2.0, noise));
      FrameState state = previous.previous;
      fit.solve(basis, {&observation, 1}, view.focal_px, use_prior ? &previous : nullptr, 20, state);
      sum += (state.expression - previous.previous.expression).squaredNorm();
      previous.previous = state;
    }
    return std::sqrt(sum / 30);
  };
  EXPECT_LT(jitter(true), 0.7 * jitter(false));

  // A jaw that opens within one frame is followed within it.
  test::SyntheticView open = view;
  open.expression.setZero();
  TemporalPrior previous{{view.pose, open.expression}, 0.04};
  open.expression[0] = 0.8;
  const Observation observation = observation_of(open, test::synthetic_landmarks(model, open, 0.0, random));
  FrameState state = previous.previous;
  fit.solve(basis, {&observation, 1}, view.focal_px, &previous, 20, state);
  EXPECT_GT(state.expression[0], 0.9 * 0.8);
}

TEST_F(CoarseFitTest, FacesBehindTheCameraAreRefused) {
  const auto view = test::random_view(model, test::random_identity(model, random), random);
  const auto face = test::synthetic_landmarks(model, view, 0.0, random);
  const Observation observation = observation_of(view, face);
  LandmarkBasis basis;
  model.contract_identity(view.identity, basis);
  FrameState state{view.pose, view.expression};
  state.pose.translation_mm.z() = -300;
  const FrameState before = state;
  EXPECT_EQ(fit.solve(basis, {&observation, 1}, view.focal_px, nullptr, 20, state).outcome,
            CoarseFitOutcome::NumericalFailure);
  EXPECT_EQ(state.pose.translation_mm, before.pose.translation_mm);
}

}  // namespace
}  // namespace facet::track
