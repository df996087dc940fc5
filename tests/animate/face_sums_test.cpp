// Sums over all captured faces, of many of them gathered beforehand: weights as good as those of every face
// by itself, and all but the same.

#include "animate/face_sums.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "support/take_actor.hpp"

namespace facet::animate {
namespace {

using Space = ControlTarget::Space;

constexpr Eigen::Index kFaces = 3 * FaceSums::kMostFaces;
constexpr Eigen::Index kNumbers = 11;

/// A point that wanders through some mm, and faces that follow it, bent and noisy.
struct Wander {
  Eigen::MatrixXd captured;
  Eigen::MatrixXf coefficients;

  Wander(unsigned seed, Eigen::Index dimensions, Eigen::Index faces = kFaces)
      : captured(dimensions, faces), coefficients(kNumbers, faces) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    const Eigen::MatrixXd ways = Eigen::MatrixXd::NullaryExpr(dimensions, 3, [&] { return normal(random); });
    const Eigen::MatrixXd follows =
        Eigen::MatrixXd::NullaryExpr(kNumbers, dimensions, [&] { return normal(random); });
    for (Eigen::Index f = 0; f < faces; ++f) {
      const double time = 0.01 * static_cast<double>(f);
      const Eigen::Vector3d parts(3 * std::sin(time), 2 * std::cos(1.7 * time), 0.5 * std::sin(0.31 * time));
      captured.col(f) = ways * parts;
      captured(0, f) += 20 + 0.05 * normal(random);
      Eigen::VectorXd face = follows * captured.col(f);
      face.array() += 0.3 * parts.x() * parts.y();
      face[0] += normal(random);
      coefficients.col(f) = face.cast<float>();
    }
    coefficients.colwise() -= coefficients.rowwise().mean().eval();
  }
  FaceSums sums(bool exact) const {
    return {captured, TakeBasis::MatrixView(coefficients.data(), coefficients.rows(), coefficients.cols()),
            exact};
  }
  /// Among the captured places, beside them and far away.
  std::vector<Eigen::VectorXd> places() const {
    const Eigen::VectorXd middle = captured.rowwise().mean();
    return {captured.col(0), captured.col(captured.cols() / 2), middle,
            middle + 1.7 * (captured.col(7) - middle),
            middle + Eigen::VectorXd::Constant(captured.rows(), 300)};
  }
};

TEST(FaceSumsTest, GatheredSumsAreThoseOfTheirWeights) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    for (const Eigen::Index dimensions : {1, 2, 3}) {
      const Wander wander(seed, dimensions);
      const FaceSums sums = wander.sums(false);
      ASSERT_TRUE(sums.is_gathered());
      for (const Eigen::VectorXd& p : wander.places()) {
        const Eigen::VectorXd weights = sums.weights(p);
        EXPECT_NEAR(weights.sum(), 1, 1e-6);
        EXPECT_GE(weights.minCoeff(), 0);
        const FaceSums::Result got = sums.at(p);
        const Eigen::VectorXd mean = wander.captured * weights;
        const Eigen::MatrixXd apart = wander.captured.colwise() - mean;
        const Eigen::MatrixXd covariance = apart * weights.asDiagonal() * apart.transpose();
        const Eigen::MatrixXd faces = wander.coefficients.cast<double>();
        const Eigen::MatrixXd moments = faces * weights.asDiagonal() * apart.transpose();
        EXPECT_LT((got.mean - mean).norm(), 1e-5);
        EXPECT_LT((got.covariance - covariance).norm(), 1e-4);
        EXPECT_LT((got.average.cast<double>() - faces * weights).norm(), 1e-4);
        EXPECT_LT((got.moments.cast<double>() - moments).norm(), 1e-3);
      }
    }
  }
}

TEST(FaceSumsTest, GatheringChangesLittle) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    const Wander wander(seed, 3);
    const FaceSums gathered = wander.sums(false);
    const FaceSums exact = wander.sums(true);
    ASSERT_TRUE(gathered.is_gathered());
    ASSERT_FALSE(exact.is_gathered());
    for (const Eigen::VectorXd& p : wander.places()) {
      const FaceSums::Result a = gathered.at(p);
      const FaceSums::Result b = exact.at(p);
      EXPECT_LT((a.mean - b.mean).norm(), 0.02) << "mm, of some 5";
      EXPECT_LT((a.average - b.average).norm(), 0.01F * b.average.norm() + 0.05F);
      EXPECT_LT((a.covariance - b.covariance).norm(), 0.02 * b.covariance.norm());
      EXPECT_LT((a.moments - b.moments).norm(), 0.02F * b.moments.norm());
    }
  }
}

TEST(FaceSumsTest, FewFacesManyPointsAndAVertexThatNeverMoves) {
  EXPECT_FALSE(Wander(1, 3, FaceSums::kMostFaces).sums(false).is_gathered());
  EXPECT_TRUE(Wander(1, 3, FaceSums::kMostFaces + 1).sums(false).is_gathered());
  EXPECT_FALSE(Wander(1, 24).sums(false).is_gathered()) << "no lattice has that many directions";
  Wander still(1, 3);
  still.captured.colwise() = Eigen::Vector3d(1, -2, 3);
  const FaceSums sums = still.sums(false);
  const FaceSums::Result got = sums.at(Eigen::Vector3d(1, 0, 3));
  EXPECT_LT((got.mean - still.captured.col(0)).norm(), 1e-6);
  EXPECT_LT(got.covariance.norm(), 1e-9);
  EXPECT_LT(got.average.norm(), 1e-3F) << "the mean face";
  EXPECT_LT(got.moments.norm(), 1e-3F);
  // A view's numbers may be of any size.
  Wander far(1, 2);
  far.captured *= 1e5;
  EXPECT_NEAR(far.sums(false).weights(far.captured.col(3)).sum(), 1, 1e-6);
}

TEST(FaceSumsTest, AFaceOfALongTakeIsPosedAsByEveryFaceByItself) {
  constexpr int kLong = static_cast<int>(FaceSums::kMostFaces) + 400;
  const test::TemporaryFolder folder;
#ifdef FACET_SANITIZED  // a minute each
  const std::vector<std::uint64_t> seeds{2};
#else
  const std::vector<std::uint64_t> seeds{1, 2, 3};
#endif
  int far = 0;
  for (const std::uint64_t seed : seeds) {
    const auto basis = TakeBasis::open(test::record_actor(folder.path(), seed, kLong));
    std::mt19937 random(static_cast<unsigned>(seed));
    FaceIk ik(basis);
    std::vector<std::vector<ControlTarget>> poses;
    for (const std::size_t count : {1U, 3U, 5U}) {
      std::vector<ControlTarget> targets;
      for (const std::int32_t vertex : test::scattered_vertices(*basis, count, random)) {
        targets.push_back({vertex, Space::Head, test::captured(*basis, random() % kLong).col(vertex)});
      }
      poses.push_back(std::move(targets));
    }
    for (const std::vector<ControlTarget>& targets : poses) {
      mesh::Vertices made[2];
      std::vector<ControlOutcome> outcomes[2];
      for (const bool every_face : {false, true}) {
        ik.set_options({.every_face = every_face});
        Pose pose;
        outcomes[every_face ? 1 : 0] = ik.solve(targets, pose);
        const Eigen::MatrixXd weights = ik.region_weights();
        EXPECT_LT((weights.colwise().sum().array() - 1).abs().maxCoeff(), 1e-6);
        made[every_face ? 1 : 0] = test::finest_of(*basis, pose);
      }
      for (std::size_t i = 0; i < targets.size(); ++i) {
        // The guard of 25 standard deviations holds some back, and does so either way.
        const float allowed = std::max(kMetHead_mm, outcomes[1][i].miss + 1e-3F);
        EXPECT_LE(outcomes[0][i].miss, allowed) << "seed " << seed;
        EXPECT_LT(outcomes[0][i].miss, 0.1F);
      }
      const float apart = (made[0] - made[1]).colwise().norm().maxCoeff();
      EXPECT_GT(apart, 0) << "both were made the same way";
      // Of forty such poses the median is 0.002 mm and the worst 0.017; another compiler's rounding put one
      // of nine 0.1 mm off, for a reason that is not known yet.
      EXPECT_LT(apart, 0.3F) << "seed " << seed << ", " << targets.size() << " points";
      far += apart > 0.05F ? 1 : 0;
    }
  }
  EXPECT_LE(far, 1);
}

}  // namespace
}  // namespace facet::animate
