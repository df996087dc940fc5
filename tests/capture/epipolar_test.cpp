#include "capture/epipolar.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace facet::capture {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

RigCamera camera(const char* name, double x_mm, double turn) {
  RigCamera made;
  made.name = name;
  Lens& lens = made.lens;
  lens.width_px = 640;
  lens.height_px = 480;
  lens.fx_px = 900;
  lens.fy_px = 903;
  lens.cx_px = 318;
  lens.cy_px = 241;
  lens.distortion = {-0.2, 0.1, 0.0004, -0.0003, 0};
  made.lens.camera_from_rig =
      Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()) * Eigen::Translation3d(-x_mm, 0, 0);
  return made;
}

class Epipolar : public ::testing::TestWithParam<double> {
 protected:
  /// Points of a face-sized volume in both pictures, with noise of 0.1 px.
  std::vector<PointMatch> matches(const RigCamera& left, const RigCamera& right) const {
    std::mt19937 random(4);
    std::uniform_real_distribution<double> uniform(-1, 1);
    std::normal_distribution<double> noise(0, 0.1);
    std::vector<PointMatch> found;
    for (int i = 0; i < 400; ++i) {
      const Eigen::Vector3d point(100 * uniform(random), 120 * uniform(random), 800 + 60 * uniform(random));
      PointMatch match{*left.lens.project(point), *right.lens.project(point)};
      match.left_px += Eigen::Vector2d(noise(random), noise(random));
      match.right_px += Eigen::Vector2d(noise(random), noise(random));
      found.push_back(match);
    }
    return found;
  }
  /// How far the cameras turn towards one another.
  const RigCamera left_ = camera("l", -30, -GetParam());
  const RigCamera right_ = camera("r", 30, GetParam());
};

TEST_P(Epipolar, MatchesOfTheRigFit) {
  const auto found = matches(left_, right_);
  const PairCheck check = check_pair(left_, right_, found);
  EXPECT_EQ(check.verdict, PairVerdict::Fine) << check.message;
  // Sampson's distance of two points with 0.1 px in each direction: 0.1 px; the median of its absolute
  // 0.0674.
  EXPECT_NEAR(check.median_px, 0.0674, 0.01);
  EXPECT_EQ(check.part_in_front, 1);
}

TEST_P(Epipolar, WrongMatchesDoNoHarmUpToAThird) {
  auto found = matches(left_, right_);
  for (std::size_t i = 0; i < found.size() / 3; ++i) {
    found[i].right_px = found[found.size() - 1 - i].right_px;
  }
  EXPECT_EQ(check_pair(left_, right_, found).verdict, PairVerdict::Fine);
}

TEST_P(Epipolar, ABumpIsNoticed) {
  const auto found = matches(left_, right_);
  RigCamera before = right_;  // the rig file knows nothing of a quarter of a degree
  before.lens.camera_from_rig =
      Eigen::AngleAxisd(0.25 * M_PI / 180, Eigen::Vector3d::UnitX()) * before.lens.camera_from_rig;
  const PairCheck check = check_pair(left_, before, found);
  EXPECT_EQ(check.verdict, PairVerdict::Misaligned);
  EXPECT_THAT(check.message, AllOf(HasSubstr("'l'"), HasSubstr("'r'"), HasSubstr("calibrate again")));
  EXPECT_GT(check.median_px, 1);
}

TEST_P(Epipolar, SwappedPicturesAreNoticed) {
  auto found = matches(left_, right_);
  for (PointMatch& match : found) {
    std::swap(match.left_px, match.right_px);
  }
  const PairCheck check = check_pair(left_, right_, found);
  EXPECT_EQ(check.verdict, PairVerdict::Swapped) << check.message;
  EXPECT_THAT(check.message, HasSubstr("swapped"));
}

TEST_P(Epipolar, TooFewMatchesSayNothing) {
  auto found = matches(left_, right_);
  found.resize(10);
  EXPECT_EQ(check_pair(left_, right_, found).verdict, PairVerdict::TooFewMatches);
  EXPECT_EQ(check_pair(left_, right_, {}).verdict, PairVerdict::TooFewMatches);
}

TEST_P(Epipolar, LinesOfSightMeetWhereThePointIs) {
  const Eigen::Vector3d point(12, -40, 790);
  const PointMatch match{*left_.lens.project(point), *right_.lens.project(point)};
  EXPECT_NEAR(epipolar_error_px(left_.lens, right_.lens, match).value(), 0, 1e-7);
  EXPECT_LT((triangulate_mm(left_.lens, right_.lens, match).value() - point).norm(), 1e-5);
}

// Parallel cameras, whose epipolar lines are the same the other way round, and cameras that look inwards.
INSTANTIATE_TEST_SUITE_P(Pair, Epipolar, ::testing::Values(0.0, 0.04, 0.3));

}  // namespace
}  // namespace facet::capture
