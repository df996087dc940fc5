#include "track/expression_reader.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <random>
#include <set>

#include "mesh/arkit.hpp"
#include "support/synthetic_model.hpp"
#include "synthetic_landmarks.hpp"

namespace facet::track {
namespace {

class Movements : public testing::Test {
 protected:
  Movements() : face_model(test::synthetic_model()), model(face_model) {
    const Eigen::VectorXd identity = test::random_identity(model, random);
    view = test::random_view(model, identity, random, 0.15);
    model.contract_identity(identity, basis);
    basis.bias_mm = Eigen::VectorXd::Zero(Eigen::Index{3} * model.count());
    face = test::synthetic_landmarks(model, view, 0, random);
  }

  LandmarkMovements moved(const FrameState& state, const FitCamera& camera = {}) const {
    FitCamera used = camera;
    used.centre_px = view.centre_px();
    LandmarkMovements out;
    landmark_movements(model, basis, face, used, view.focal_px, state, out);
    return out;
  }
  Eigen::Matrix2Xf movements(const FrameState& state, const FitCamera& camera = {}) const {
    return moved(state, camera).mm;
  }
  /// rms difference from where an expression has the landmarks, mm.
  double apart(const Eigen::Matrix2Xf& got, const Eigen::VectorXd& expression) const {
    const Eigen::VectorXd moved = basis.deltas_mm * expression;
    double sum = 0;
    for (Eigen::Index l = 0; l < got.cols(); ++l) {
      sum += (got.col(l).cast<double>() - moved.segment<2>(3 * l)).squaredNorm();
    }
    return std::sqrt(sum / static_cast<double>(got.cols()));
  }

  std::mt19937 random{7};
  face::FaceModel face_model;
  LandmarkModel model;
  LandmarkBasis basis;
  test::SyntheticView view;
  landmark::FaceLandmarks face;
};

TEST_F(Movements, AreWhatThePictureShowsWhateverTheFitSays) {
  EXPECT_LT(apart(movements({view.pose, view.expression}), view.expression), 1e-3);
  // The fit has not followed: what it lacks comes from the picture, but for the depth that it hides and for
  // what is drawn in, of landmarks that are some millimetres off.
  const FrameState at_rest{view.pose, Eigen::VectorXd::Zero(view.expression.size())};
  const double shown = apart(Eigen::Matrix2Xf::Zero(2, model.count()), view.expression);
  ASSERT_GT(shown, 0.3) << "the view has an expression";
  EXPECT_LT(apart(movements(at_rest), view.expression), 0.3 * shown);
}

TEST_F(Movements, AreTheSameFromAnotherCamera) {
  FitCamera beside{.focal_ratio = 1.2};
  beside.view_from_reference =
      Eigen::Translation3d(-150, 10, 40) * Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY());
  test::SyntheticView from_there = view;
  from_there.focal_px *= beside.focal_ratio;
  from_there.pose.rotation = beside.view_from_reference.linear() * view.pose.rotation;
  from_there.pose.translation_mm = beside.view_from_reference * view.pose.translation_mm;
  face = test::synthetic_landmarks(model, from_there, 0, random);
  const FrameState at_rest{view.pose, Eigen::VectorXd::Zero(view.expression.size())};
  EXPECT_LT(apart(movements({view.pose, view.expression}, beside), view.expression), 1e-3);
  const double shown = apart(Eigen::Matrix2Xf::Zero(2, model.count()), view.expression);
  EXPECT_LT(apart(movements(at_rest, beside), view.expression), 0.4 * shown);
}

TEST_F(Movements, WhatIsNotSeenIsWhereTheFitHasIt) {
  face.confidence.setZero();
  face.iris_confidence = {0, 0};
  const Eigen::VectorXd fitted = 0.5 * view.expression;
  EXPECT_LT(apart(movements({view.pose, fitted}), fitted), 1e-3);
  EXPECT_EQ(moved({view.pose, fitted}).seen.maxCoeff(), 0);
}

TEST_F(Movements, ALandmarkThatIsFarOffHardlyCounts) {
  const FrameState state{view.pose, view.expression};
  const int landmark = model.landmarks().front();
  face.points_px(0, landmark) += 200;
  EXPECT_LT(apart(movements(state), view.expression), 0.5) << "100 mm off";
  const Eigen::VectorXf seen = moved(state).seen;
  EXPECT_LT(seen[0], 0.01);
  EXPECT_GT(seen.maxCoeff(), 0.99);
}

TEST_F(Movements, TheLandmarksBiasIsNoMovement) {
  basis.bias_mm.setConstant(0.4);
  const FrameState state{view.pose, view.expression};
  const Eigen::Matrix2Xf got = movements(state);
  EXPECT_NEAR((got.cast<double>().row(0).transpose() -
               (basis.deltas_mm * view.expression)(Eigen::seq(0, Eigen::last, 3)))
                  .mean(),
              -0.4, 0.1)
      << "the landmarks lie without the bias that the person has";
}

class Reader : public testing::Test {
 protected:
  Reader() : face_model(test::synthetic_model()), model(face_model) {
    reading.names = {face_model.expression_names[1], face_model.expression_names[0]};
    reading.landmarks = {model.landmarks()[2], model.landmarks()[5]};
    reading.evidence.setZero(2, 6);
    reading.certainty.setIdentity(2, 2);
    values.assign(face_model.expression_names.size(), 0.5F);
    movements.mm.setZero(2, model.count());
    movements.seen.setOnes(model.count());
    movements.mm.col(2) << 2, 7;
    movements.mm.col(5) << 7, 1;
  }

  face::FaceModel face_model;
  LandmarkModel model;
  ExpressionReading reading;
  LandmarkMovements movements;
  std::vector<float> values;
  std::vector<float> confidence;
};

TEST_F(Reader, ReadsItsNamesAndLeavesTheOthers) {
  // 2 mm to the left of one landmark, 1 mm up of the other, and half of the second name's fitted weight.
  reading.evidence.row(0) << 0.1F, 0, 0, 0.2F, 0, 0.1F / kFittedMm;
  reading.evidence.row(1) << -1, 0, 0, 0, 0, 0;
  reading.rare = 0.05F;
  ExpressionReader(model, face_model.expression_names, reading).read(movements, values, confidence);
  EXPECT_NEAR(values[1], 0.2 + 0.2 + 0.05 - 0.05, 1e-6);
  EXPECT_EQ(values[0], 0) << "below 0";
  for (std::size_t e = 2; e < values.size(); ++e) {
    EXPECT_EQ(values[e], 0.5F);
  }
}

TEST_F(Reader, FindsTheValuesThatFitTogetherWithinTheirBounds) {
  reading.certainty << 1, 0.5F, 0.5F, 1;
  reading.evidence(0, 0) = 0.2F;
  reading.evidence(1, 0) = 0.25F;
  ExpressionReader reader(model, face_model.expression_names, reading);
  reader.read(movements, values, confidence);
  EXPECT_NEAR(values[1], 0.2, 1e-3) << "(0.4, 0.5) by the inverse of the certainty";
  EXPECT_NEAR(values[0], 0.4, 1e-3);
  movements.mm.col(2) << 4, 0;
  reading.evidence(0, 0) = 0.5F;
  reading.evidence(1, 0) = 0.225F;
  reader.read(movements, values, confidence);
  EXPECT_EQ(values[1], 1) << "2 less a half of the other, at its bound";
  EXPECT_NEAR(values[0], 0.9 - 0.5, 1e-3) << "the other knows";
}

TEST_F(Reader, BelievesAValueByWhatIsKnownOfItAndSeen) {
  // The first name is read off both landmarks, three times as far off the second; the other off the second.
  reading.evidence.row(0) << 1, 0, 0, std::sqrt(3.0F), 0, 0;
  reading.evidence.row(1) << 0, 0, 1, 0, 0, 0;
  ExpressionReader unknown(model, face_model.expression_names, reading);
  unknown.read(movements, values, confidence);
  EXPECT_TRUE(confidence.empty()) << "nothing is known of it";
  reading.told.resize(2);
  reading.told << 0.8F, 0.4F;
  ExpressionReader reader(model, face_model.expression_names, reading);
  movements.seen[5] = 0.5F;
  reader.read(movements, values, confidence);
  ASSERT_EQ(confidence.size(), values.size());
  EXPECT_NEAR(confidence[1], 0.8 * (0.25 + 0.75 * 0.5), 1e-6);
  EXPECT_NEAR(confidence[0], 0.4 * 0.5, 1e-6);
  for (std::size_t e = 2; e < confidence.size(); ++e) {
    EXPECT_EQ(confidence[e], 0) << "is not read";
  }
}

TEST_F(Reader, AMouthThatStandsToOneSideMostOfTheTimeRestsThere) {
  const std::vector<std::string> sides{"mouthRight", "mouthLeft"};
  reading.names = {sides[1], sides[0]};  // left, right
  values.assign(2, 0);
  reading.evidence(1, 0) = 0.1F;  // right by the first landmark's place to the left
  reading.evidence(0, 0) = -0.1F;
  ExpressionReader reader(model, sides, reading);
  const auto right_of = [&](float mm) {
    movements.mm.col(2) << mm, 0;
    reader.read(movements, values, confidence);
    return values[0] - values[1];
  };
  constexpr float kSlack = 0.01F;
  for (int f = 0; f < 600; ++f) {
    right_of(f % 3 == 0 ? 6 : 2);  // a third of the time at 0.6
  }
  EXPECT_NEAR(right_of(2), 0, kSlack);
  EXPECT_NEAR(right_of(6), 0.4, kSlack);
  EXPECT_NEAR(right_of(-2), -0.4, kSlack) << "to the left of where it rests";
  EXPECT_EQ(values[0], 0);
  for (int f = 0; f < 300; ++f) {
    right_of(6);
  }
  EXPECT_GT(right_of(6), 0.2) << "held for ten seconds";
  reader.forget();
  right_of(0);
  EXPECT_NEAR(right_of(6), 0.6, 0.16) << "another face";
}

TEST_F(Reader, AModelThatLacksALandmarkOrANameIsNotRead) {
  reading.told.setOnes(2);
  confidence.assign(values.size(), 1);
  ExpressionReading unknown = reading;
  unknown.names[1] = "earWiggle";
  ExpressionReader(model, face_model.expression_names, unknown).read(movements, values, confidence);
  EXPECT_TRUE(confidence.empty());
  confidence.assign(values.size(), 1);
  ExpressionReading elsewhere = reading;
  elsewhere.landmarks[1] = landmark::kRightIris;
  ASSERT_EQ(model.position_of(landmark::kRightIris), -1) << "the model has no eyeballs";
  ExpressionReader(model, face_model.expression_names, elsewhere).read(movements, values, confidence);
  EXPECT_THAT(values, testing::Each(0.5F));
  EXPECT_TRUE(confidence.empty());
}

TEST(LearnedReading, KnowsArkitsNamesAndBothSidesAlike) {
  const ExpressionReading& reading = learned_reading();
  EXPECT_TRUE(std::is_sorted(reading.landmarks.begin(), reading.landmarks.end()));
  EXPECT_EQ(std::set<int>(reading.landmarks.begin(), reading.landmarks.end()).size(),
            reading.landmarks.size());
  const auto names = static_cast<Eigen::Index>(reading.names.size());
  ASSERT_EQ(reading.evidence.rows(), names);
  ASSERT_EQ(reading.evidence.cols(), static_cast<Eigen::Index>(2 * reading.landmarks.size()) + names);
  ASSERT_EQ(reading.certainty.rows(), names);
  ASSERT_EQ(reading.certainty.cols(), names);
  const Eigen::MatrixXf certainty = reading.certainty;
  EXPECT_EQ(certainty, certainty.transpose().eval());
  EXPECT_GT(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXf>(certainty).eigenvalues().minCoeff(), 0);
  ASSERT_EQ(reading.told.size(), names);
  EXPECT_GE(reading.told.minCoeff(), 0);
  EXPECT_LE(reading.told.maxCoeff(), 1);
  const auto told = [&](const char* name) {
    return reading.told[std::find(reading.names.begin(), reading.names.end(), name) - reading.names.begin()];
  };
  EXPECT_GT(told("jawOpen"), told("mouthShrugUpper"));
  EXPECT_EQ(told("eyeBlinkLeft"), told("eyeBlinkRight"));
  EXPECT_EQ(reading.names.size(), mesh::kArkitNames.size() - 1) << "all but tongueOut";
  for (std::size_t n = 0; n < reading.names.size(); ++n) {
    EXPECT_GE(mesh::arkit_index(reading.names[n]), 0) << reading.names[n];
    const std::string& left = reading.names[n];
    if (!left.ends_with("Left")) {
      continue;
    }
    const auto right =
        std::find(reading.names.begin(), reading.names.end(), left.substr(0, left.size() - 4) + "Right");
    ASSERT_NE(right, reading.names.end()) << left;
    const auto size = [&](Eigen::Index row) { return static_cast<double>(reading.evidence.row(row).norm()); };
    const double here = size(static_cast<Eigen::Index>(n));
    EXPECT_GT(here, 0);
    EXPECT_NEAR(size(right - reading.names.begin()) / here, 1, 0.2) << left;
  }
}

}  // namespace
}  // namespace facet::track
