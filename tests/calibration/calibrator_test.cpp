#include "calibration/calibrator.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/calib3d.hpp>

#include "capture/epipolar.hpp"
#include "facet/error.hpp"
#include "support/board_views.hpp"

namespace facet::calibration {
namespace {

using simulation::Random;
using ::testing::AllOf;
using ::testing::HasSubstr;

std::vector<CalibrationCamera> cameras_of(const capture::Rig& rig) {
  std::vector<CalibrationCamera> cameras;
  for (const capture::RigCamera& camera : rig.cameras) {
    cameras.push_back({camera.name, camera.lens.width_px, camera.lens.height_px, camera.colour});
  }
  return cameras;
}

std::vector<CalibrationView> views_of(const Board& board, const capture::Rig& rig,
                                      const std::vector<Eigen::Isometry3d>& poses, double noise_px,
                                      std::uint64_t seed) {
  Random random(seed, 0);
  std::vector<CalibrationView> views;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    views.push_back({"view " + std::to_string(i), {}});
    for (const capture::RigCamera& camera : rig.cameras) {
      views.back().seen.push_back(seen_corners(board, camera.lens, poses[i], noise_px, random));
    }
  }
  return views;
}

std::string error_of(const capture::Rig& rig, const std::vector<CalibrationView>& views,
                     const CalibratorOptions& options = {}, ErrorKind kind = ErrorKind::UnreadableInput) {
  try {
    calibrate({}, cameras_of(rig), views, options);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), kind);
    return error.what();
  }
  return "no error";
}

double baseline_mm(const capture::Rig& rig, const capture::StereoPair& pair) {
  return (rig.cameras[pair.left].lens.centre_mm() - rig.cameras[pair.right].lens.centre_mm()).norm();
}

capture::Rig only(const capture::Rig& rig, const std::vector<std::size_t>& cameras) {
  capture::Rig part;
  for (const std::size_t camera : cameras) {
    part.cameras.push_back(rig.cameras[camera]);
  }
  return part;
}

TEST(Bundle, DerivativesAreThoseOfDifferences) {
  const capture::Rig rig = booth_rig(9);
  const Eigen::Isometry3d pose = held_board_poses({}, 1, 2).front();
  BundleProblem problem{{rig.cameras[1].lens}, {pose}, {}};
  problem.lenses[0].distortion.k3 = 0.03;
  constexpr double kStep = 1e-6;
  for (const Eigen::Vector3d& corner : corners_mm({})) {
    const CornerObservation observation{0, 0, corner, {300, 200}};
    Eigen::Matrix<double, 2, kIntrinsicCount> by_intrinsics;
    Eigen::Matrix<double, 2, 6> by_camera;
    Eigen::Matrix<double, 2, 6> by_board;
    residual_px(problem, observation, &by_intrinsics, &by_camera, &by_board);
    const auto difference = [&](const auto& change) {
      BundleProblem more = problem;
      BundleProblem less = problem;
      change(more, kStep);
      change(less, -kStep);
      return Eigen::Vector2d((residual_px(more, observation, nullptr, nullptr, nullptr) -
                              residual_px(less, observation, nullptr, nullptr, nullptr)) /
                             (2 * kStep));
    };
    for (int k = 0; k < kIntrinsicCount; ++k) {
      const Eigen::Vector2d slope = difference([&](BundleProblem& changed, double by) {
        change_intrinsics(changed.lenses[0], by * Eigen::Matrix<double, kIntrinsicCount, 1>::Unit(k));
      });
      EXPECT_LT((slope - by_intrinsics.col(k)).norm(), 1e-5 * (1 + slope.norm())) << k;
    }
    for (int k = 0; k < 6; ++k) {
      const Eigen::Matrix<double, 6, 1> unit = Eigen::Matrix<double, 6, 1>::Unit(k);
      const Eigen::Vector2d camera = difference([&](BundleProblem& changed, double by) {
        changed.lenses[0].camera_from_rig = moved(changed.lenses[0].camera_from_rig, by * unit);
      });
      const Eigen::Vector2d board = difference([&](BundleProblem& changed, double by) {
        changed.world_from_board[0] = moved(changed.world_from_board[0], by * unit);
      });
      EXPECT_LT((camera - by_camera.col(k)).norm(), 1e-5 * (1 + camera.norm())) << k;
      EXPECT_LT((board - by_board.col(k)).norm(), 1e-5 * (1 + board.norm())) << k;
    }
  }
}

/// Another formulation of the same least squares: OpenCV's, for one camera.
TEST(Calibrator, OneCameraComesOutAsFromOpenCv) {
  const capture::Rig rig = only(booth_rig(4), {2});
  const auto poses = held_board_poses({}, 20, 8);
  const auto views = views_of({}, rig, poses, 0.1, 5);
  const Calibration found = calibrate({}, cameras_of(rig), views, {});
  ASSERT_TRUE(found.rejected.size() < 8);
  std::vector<std::vector<cv::Point3f>> boards;
  std::vector<std::vector<cv::Point2f>> pictures;
  const std::vector<Eigen::Vector3d> corners = corners_mm({});
  for (const CalibrationView& view : views) {
    if (!view.seen[0].usable()) {
      continue;
    }
    boards.emplace_back();
    pictures.emplace_back();
    for (std::size_t i = 0; i < view.seen[0].ids.size(); ++i) {
      const Eigen::Vector3f corner = corners[static_cast<std::size_t>(view.seen[0].ids[i])].cast<float>();
      const Eigen::Vector2f px = view.seen[0].px[i].cast<float>();
      boards.back().emplace_back(corner.x(), corner.y(), corner.z());
      pictures.back().emplace_back(px.x(), px.y());
    }
  }
  cv::Mat matrix;
  cv::Mat distortion;
  std::vector<cv::Mat> turns;
  std::vector<cv::Mat> shifts;
  const double rms = cv::calibrateCamera(boards, pictures, {640, 480}, matrix, distortion, turns, shifts,
                                         cv::CALIB_FIX_K3, {3, 200, 1e-12});
  const capture::Lens& lens = found.rig.cameras[0].lens;
  // Corners of 2 sqrt(1) px and more count less here (Huber); none of these is.
  EXPECT_NEAR(found.rms_px, rms, 1e-5);
  EXPECT_NEAR(lens.fx_px, matrix.at<double>(0, 0), 0.01);
  EXPECT_NEAR(lens.fy_px, matrix.at<double>(1, 1), 0.01);
  EXPECT_NEAR(lens.cx_px, matrix.at<double>(0, 2), 0.01);
  EXPECT_NEAR(lens.cy_px, matrix.at<double>(1, 2), 0.01);
  EXPECT_NEAR(lens.distortion.k1, distortion.at<double>(0), 1e-4);
  EXPECT_NEAR(lens.distortion.p2, distortion.at<double>(3), 1e-5);
}

TEST(Calibrator, WithoutNoiseTheRigIsExact) {
  const capture::Rig truth = booth_rig(21);
  const Calibration found =
      calibrate({}, cameras_of(truth), views_of({}, truth, held_board_poses({}, 40, 3), 0, 1), {});
  EXPECT_LT(found.rms_px, 1e-6);
  std::vector<capture::Lens> lenses;
  for (const capture::RigCamera& camera : truth.cameras) {
    lenses.push_back(camera.lens);
  }
  const Eigen::Isometry3d truth_from_found = mean_camera(lenses);
  for (std::size_t i = 0; i < truth.cameras.size(); ++i) {
    const capture::Lens& lens = found.rig.cameras[i].lens;
    const capture::Lens& expected = truth.cameras[i].lens;
    EXPECT_NEAR(lens.fx_px, expected.fx_px, 1e-4);
    EXPECT_NEAR(lens.distortion.k1, expected.distortion.k1, 1e-6);
    const Eigen::Isometry3d pose = expected.camera_from_rig * truth_from_found;
    EXPECT_LT((lens.camera_from_rig.matrix() - pose.matrix()).cwiseAbs().maxCoeff(), 1e-4);
  }
  ASSERT_EQ(found.rig.pairs.size(), 2U);
  for (const capture::StereoPair& pair : found.rig.pairs) {
    EXPECT_EQ(found.rig.cameras[pair.left].name + "|" + found.rig.cameras[pair.right].name,
              pair.left < 2 ? "left-a|left-b" : "right-a|right-b");
  }
}

/// The bar: focal length within 0.1 %, baseline within 0.1 mm, with 0.1 px of noise; of six cameras and 60
/// views.
TEST(Calibrator, FocalLengthAndBaselineUnderNoise) {
  for (const std::uint64_t seed : {31U, 32U, 33U}) {
    const capture::Rig truth = booth_rig(seed);
    const auto views = views_of({}, truth, held_board_poses({}, 60, seed), 0.1, seed);
    const Calibration found = calibrate({}, cameras_of(truth), views, {});
    for (std::size_t i = 0; i < truth.cameras.size(); ++i) {
      const double fx = truth.cameras[i].lens.fx_px;
      EXPECT_LT(std::abs(found.rig.cameras[i].lens.fx_px / fx - 1), 1e-3) << truth.cameras[i].name;
      // What it says of its own uncertainty is about true.
      EXPECT_LT(std::abs(found.rig.cameras[i].lens.fx_px - fx), 5 * found.cameras[i].sigma[0]);
      EXPECT_LT(found.cameras[i].sigma[0] / fx, 5e-4);
    }
    for (const PairReport& pair : found.pairs) {
      EXPECT_NEAR(pair.baseline_mm, baseline_mm(truth, pair.pair), 0.1);
      EXPECT_LT(pair.epipolar_rms_px, 0.15);
    }
    EXPECT_NEAR(found.rms_px, 0.1 * std::sqrt(2.0), 0.01);
  }
}

class BadViews : public ::testing::Test {
 protected:
  std::vector<CalibrationView> views(const capture::Rig& rig, int count = 30, double noise = 0.1) const {
    return views_of({}, rig, held_board_poses({}, count, 6), noise, 7);
  }
  const capture::Rig pair_ = only(booth_rig(5), {0, 1});
};

TEST_F(BadViews, ParallelBoardsDoNotShowTheFocalLength) {
  std::vector<Eigen::Isometry3d> poses;
  const Eigen::Isometry3d facing = pair_.cameras[0].lens.camera_from_rig.inverse();
  for (int i = 0; i < 20; ++i) {
    poses.push_back(facing * Eigen::Translation3d(-100 + 5 * i, -70 + 7 * (i % 4), 700 + 12 * i));
  }
  EXPECT_THAT(error_of(pair_, views_of({}, pair_, poses, 0.1, 7)),
              AllOf(HasSubstr("'left-a'"), HasSubstr("focal length can't be seen"), HasSubstr("Tilt")));
}

TEST_F(BadViews, TooFewViewsNameTheCameraAndTheReasons) {
  std::vector<CalibrationView> few = views(pair_, 12);
  for (std::size_t i = 0; i < 7; ++i) {
    few[i].seen[1] = {};
    few[i].seen[1].problem = "no marker of the board is seen";
  }
  EXPECT_THAT(error_of(pair_, few),
              AllOf(HasSubstr("camera 'left-b'"), HasSubstr("of 12 pictures"),
                    HasSubstr("no marker of the board is seen"), HasSubstr("--squares")));
}

TEST_F(BadViews, CamerasThatNeverSeeTheBoardTogetherAreNamed) {
  std::vector<CalibrationView> apart = views(pair_, 40);
  for (std::size_t i = 0; i < apart.size(); ++i) {
    BoardView& hidden = apart[i].seen[i % 2];
    hidden = {};
    hidden.problem = "no marker of the board is seen";
  }
  EXPECT_THAT(error_of(pair_, apart),
              AllOf(HasSubstr("'left-a'"), HasSubstr("'left-b'"), HasSubstr("at once")));
}

TEST_F(BadViews, PicturesOfDifferentMomentsAreNoticed) {
  std::vector<CalibrationView> shifted = views(pair_);
  for (std::size_t i = 0; i + 1 < shifted.size(); ++i) {
    shifted[i].seen[1] = shifted[i + 1].seen[1];
  }
  EXPECT_THAT(error_of(pair_, shifted),
              AllOf(HasSubstr("do not agree where the board was"), HasSubstr("moments")));
}

TEST_F(BadViews, SwappedCamerasDoNotFitTheirPair) {
  std::vector<CalibrationView> swapped = views(pair_);
  for (CalibrationView& view : swapped) {
    std::swap(view.seen[0], view.seen[1]);
  }
  EXPECT_THAT(error_of(pair_, swapped, {.pairs = {{"left-a", "left-b"}}}, ErrorKind::Usage),
              AllOf(HasSubstr("to the left"), HasSubstr("swapped")));
  EXPECT_THAT(error_of(pair_, views(pair_), {.pairs = {{"left-a", "left-b"}}}), HasSubstr("no error"));
  EXPECT_THAT(error_of(pair_, views(pair_), {.pairs = {{"left-a", "nobody"}}}, ErrorKind::Usage),
              HasSubstr("no camera 'nobody'"));
}

TEST_F(BadViews, OutliersAreLeftOutAndNamed) {
  std::vector<CalibrationView> some = views(pair_);
  // One picture of another moment, and one whose corners are off by several pixels here and there.
  some[3].seen[1] = some[20].seen[1];
  Random random(3, 3);
  for (Eigen::Vector2d& px : some[9].seen[0].px) {
    px += Eigen::Vector2d(static_cast<double>(random.uniform(-4, 4)),
                          static_cast<double>(random.uniform(-4, 4)));
  }
  const Calibration found = calibrate({}, cameras_of(pair_), some, {});
  std::vector<std::string> reasons;
  for (const RejectedPicture& rejected : found.rejected) {
    reasons.push_back(rejected.camera + " " + rejected.view + ": " + rejected.reason);
  }
  EXPECT_THAT(reasons, ::testing::Contains(HasSubstr("left-a view 9: does not fit")));
  EXPECT_THAT(reasons, ::testing::Contains(HasSubstr("view 3: does not fit")));
  EXPECT_NEAR(found.pairs.at(0).baseline_mm, baseline_mm(pair_, {0, 1}), 0.2);
  EXPECT_LT(found.rms_px, 0.16);
}

TEST_F(BadViews, TooObliqueBoardsAreLeftOut) {
  auto poses = held_board_poses({}, 25, 6);
  const Eigen::Isometry3d rig_from_camera = pair_.cameras[0].lens.camera_from_rig.inverse();
  poses.push_back(rig_from_camera * Eigen::Translation3d(0, -70, 800) *
                  Eigen::AngleAxisd(76 * M_PI / 180, Eigen::Vector3d::UnitY()) *
                  Eigen::Translation3d(-90, 0, 0));
  const Calibration found = calibrate({}, cameras_of(pair_), views_of({}, pair_, poses, 0.1, 7), {});
  std::vector<std::string> reasons;
  for (const RejectedPicture& rejected : found.rejected) {
    reasons.push_back(rejected.view + " " + rejected.reason);
  }
  EXPECT_THAT(reasons, ::testing::Contains(HasSubstr("view 25 too oblique")));
}

TEST(MeanCamera, IsTheMiddleOfTheCameras) {
  const capture::Rig rig = booth_rig(2);
  std::vector<capture::Lens> lenses;
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const capture::RigCamera& camera : rig.cameras) {
    lenses.push_back(camera.lens);
    middle += camera.lens.centre_mm() / static_cast<double>(rig.cameras.size());
  }
  const Eigen::Isometry3d mean = mean_camera(lenses);
  EXPECT_LT((mean.translation() - middle).norm(), 1e-9);
  EXPECT_LT((mean.linear() - Eigen::Matrix3d::Identity()).norm(), 0.15);  // the booth's cameras look along z
  // Cameras all around have no mean direction.
  lenses.resize(2);
  lenses[1].camera_from_rig = Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitY()) * lenses[0].camera_from_rig;
  EXPECT_LT((mean_camera(lenses).matrix() - lenses[0].camera_from_rig.inverse().matrix()).norm(), 1e-12);
}

TEST(Coverage, CountsCells) {
  Coverage coverage(640, 480);
  BoardView view;
  view.px = {{0, 0}, {639, 479}, {640, 10}, {-3, 5}};
  coverage.add(view);
  EXPECT_DOUBLE_EQ(coverage.part(), 2.0 / 48);
  EXPECT_EQ(coverage.count(0, 0), 1);
  EXPECT_EQ(coverage.count(7, 5), 1);
}

}  // namespace
}  // namespace facet::calibration
