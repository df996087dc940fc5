#include "landmark/landmarker.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "support/frames.hpp"

namespace facet::landmark {
namespace {

using test::frame_of;
using test::similarity;
using test::warped;

constexpr double quarter = std::numbers::pi / 2;

/// The nets and a photograph with three faces.
class LandmarkerTest : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(test::landmark_nets())) {
      GTEST_SKIP() << test::landmark_nets() << " is missing (packaging/fetch-assets)";
    }
    photo = test::read_photo("sample3.jpg");
    if (photo.empty()) {
      GTEST_SKIP() << "assets/photos/sample3.jpg is missing (packaging/fetch-assets)";
    }
    solo = photo(cv::Rect(470, 180, 450, 600)).clone();
    landmarker = std::make_unique<Landmarker>(test::landmark_nets());
  }

  /// The left face alone, seen through a similarity that carries its centre to the canvas's.
  cv::Matx23d view(double scale, double rotation_rad, cv::Size canvas) const {
    return similarity(face_centre, {0.5 * canvas.width, 0.5 * canvas.height}, scale, rotation_rad);
  }

  /// Points of the photograph's face as they should be in a view of it.
  static Eigen::Matrix2Xf carried(const cv::Matx23d& view, const Eigen::Matrix3Xf& points_px) {
    Eigen::Matrix2f turn;
    turn << static_cast<float>(view(0, 0)), static_cast<float>(view(0, 1)), static_cast<float>(view(1, 0)),
        static_cast<float>(view(1, 1));
    const Eigen::Vector2f move(static_cast<float>(view(0, 2)), static_cast<float>(view(1, 2)));
    return (turn * points_px.topRows<2>()).colwise() + move;
  }

  /// Root mean square distance, in interocular distances of the found face.
  static float error(const FaceLandmarks& face, const Eigen::Matrix2Xf& expected) {
    const float squared = (face.points_px.topRows<2>() - expected).colwise().squaredNorm().mean();
    return std::sqrt(squared) / face.interocular_px;
  }

  const cv::Point2d face_centre{226, 295};  ///< in `solo`; about 175 px wide
  cv::Mat photo;                            ///< three faces
  cv::Mat solo;                             ///< a part of it with one face
  std::unique_ptr<Landmarker> landmarker;
};

TEST_F(LandmarkerTest, FindsEveryFaceOfTheGroups) {
  const std::vector<std::size_t> faces{3, 3, 3, 4, 5, 4};
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const cv::Mat group = test::read_photo("sample" + std::to_string(i + 1) + ".jpg");
    ASSERT_FALSE(group.empty());
    const auto found = landmarker->find_all(frame_of(group));
    EXPECT_EQ(found.size(), faces[i]) << "sample" << i + 1;
    for (const FaceLandmarks& face : found) {
      EXPECT_GT(face.presence, 0.5F);
      EXPECT_LT(face.shape_error, 0.1F);
      EXPECT_EQ(face.points_px.cols(), landmark_count);
      EXPECT_EQ(face.confidence.size(), landmark_count);
      // Eyes above the mouth, in the head's own direction.
      const Eigen::Vector3f eyes = 0.5F * (face.points_px.col(33) + face.points_px.col(263));
      const Eigen::Vector3f mouth = 0.5F * (face.points_px.col(13) + face.points_px.col(14));
      EXPECT_GT((mouth - eyes).head<2>().dot(face.window.down()), 0.5F * face.interocular_px);
    }
  }
}

TEST_F(LandmarkerTest, FollowsTheImageThroughScaleAndRotation) {
  landmarker->forget();
  const cv::Size canvas(900, 900);
  const auto first_view = view(1, 0, canvas);
  const auto reference = landmarker->process(frame_of(warped(solo, first_view, canvas))).face;
  ASSERT_LT((reference.window.centre_px - Eigen::Vector2f(450, 450)).norm(), 60);
  for (const double scale : {0.35, 0.7, 1.6}) {
    for (const double rotation : {0.0, 0.25, -0.6, 1.2, quarter, -quarter}) {
      const cv::Matx23d second_view = view(scale, rotation, canvas);
      const auto moved = frame_of(warped(solo, second_view, canvas));
      landmarker->forget();
      LandmarkResult result = landmarker->process(moved);
      for (int round = 0; round < 20 && !result.found; ++round) {
        result = landmarker->process(moved);
      }
      ASSERT_TRUE(result.found) << "scale " << scale << " rotation " << rotation;
      const cv::Matx33d inverse = cv::Matx33d(first_view(0, 0), first_view(0, 1), first_view(0, 2),
                                              first_view(1, 0), first_view(1, 1), first_view(1, 2), 0, 0, 1)
                                      .inv();
      const cv::Matx23d between = second_view * inverse;
      EXPECT_LT(error(result.face, carried(between, reference.points_px)), 0.025F)
          << "scale " << scale << " rotation " << rotation;
    }
  }
}

TEST_F(LandmarkerTest, AStillImageStandsStill) {
  const Frame frame = frame_of(solo);
  for (const bool smooth : {false, true}) {
    Landmarker still(test::landmark_nets(), {.smooth = smooth});
    for (int i = 0; i < 40; ++i) {
      still.process(frame);
    }
    const Eigen::Matrix3Xf settled = still.process(frame).face.points_px;
    for (int i = 0; i < 15; ++i) {
      const LandmarkResult& result = still.process(frame);
      ASSERT_TRUE(result.found);
      EXPECT_FALSE(result.acquired);
      EXPECT_LE((result.face.points_px - settled).cwiseAbs().maxCoeff(), smooth ? 1e-3F : 0.0F);
    }
  }
}

TEST_F(LandmarkerTest, FindsASmallFace) {
  // A face of 60 px, ear to ear, in 1280 x 720.
  const cv::Size canvas(1280, 720);
  cv::Mat small;
  cv::resize(photo(cv::Rect(500, 230, 390, 480)), small, {}, 60.0 / 175, 60.0 / 175, cv::INTER_AREA);
  for (const cv::Point corner : {cv::Point(5, 5), cv::Point(570, 300), cv::Point(1140, 550)}) {
    cv::Mat picture(canvas, CV_8UC3, cv::Scalar(120, 130, 110));
    small.copyTo(picture(cv::Rect(corner, small.size())));
    landmarker->forget();
    const Frame frame = frame_of(picture);
    LandmarkResult result;
    for (int round = 0; round < 20 && !result.found; ++round) {
      result = landmarker->process(frame);
    }
    ASSERT_TRUE(result.found) << corner;
    EXPECT_LT((result.face.window.centre_px -
               Eigen::Vector2f(static_cast<float>(corner.x) + 67, static_cast<float>(corner.y) + 80))
                  .norm(),
              20)
        << corner;
  }
}

TEST_F(LandmarkerTest, StaysOnItsFaceWhileAnotherPasses) {
  // The own face stands; a larger one moves past beside it, overlapping its window, and stops next to it.
  const cv::Mat own = photo(cv::Rect(560, 250, 280, 400));
  cv::Mat other;
  cv::resize(photo(cv::Rect(1030, 190, 300, 380)), other, {}, 1.3, 1.3, cv::INTER_LINEAR);
  const auto picture = [&](int other_x) {
    cv::Mat canvas(600, 1600, CV_8UC3, cv::Scalar(100, 100, 100));
    if (other_x >= 0) {
      other.copyTo(canvas(cv::Rect(cv::Point(other_x, 60), other.size())));
    }
    own.copyTo(canvas(cv::Rect(cv::Point(300, 100), own.size())));
    return frame_of(canvas);
  };
  ASSERT_TRUE(landmarker->process(picture(-1)).found);
  const Eigen::Vector2f place = landmarker->process(picture(-1)).face.window.centre_px;
  for (int x = 1200; x >= 400; x -= 40) {
    const LandmarkResult& result = landmarker->process(picture(x));
    ASSERT_TRUE(result.found) << x;
    ASSERT_FALSE(result.acquired) << x;
    ASSERT_LT((result.face.window.centre_px - place).norm(), 40) << x;
  }
}

TEST_F(LandmarkerTest, ComesBackToItsFaceAfterAnotherPassedBeforeIt) {
  const cv::Mat own = photo(cv::Rect(560, 250, 280, 400));
  for (const double scale : {0.8, 1.0, 1.3}) {
    cv::Mat other;
    cv::resize(photo(cv::Rect(1030, 190, 300, 380)), other, {}, scale, scale, cv::INTER_LINEAR);
    const auto picture = [&](int other_x) {
      cv::Mat canvas(600, 1600, CV_8UC3, cv::Scalar(100, 100, 100));
      own.copyTo(canvas(cv::Rect(300, 100, 280, 400)));
      other.copyTo(canvas(cv::Rect(cv::Point(other_x, 60), other.size())));
      return frame_of(canvas);
    };
    landmarker->forget();
    const LandmarkResult& result = landmarker->process(frame_of([&] {
      cv::Mat alone(600, 1600, CV_8UC3, cv::Scalar(100, 100, 100));
      own.copyTo(alone(cv::Rect(300, 100, 280, 400)));
      return alone;
    }()));
    ASSERT_TRUE(result.found);
    const Region place = result.face.window;
    for (int x = 800; x >= 0; x -= 25) {
      landmarker->process(picture(x));
      if (result.found) {
        EXPECT_LT((result.face.window.centre_px - place.centre_px).norm(), 0.35F * place.size_px)
            << "scale " << scale << " at " << x;
      }
    }
    ASSERT_TRUE(result.found) << scale;
    EXPECT_LT((result.face.window.centre_px - place.centre_px).norm(), 0.06F * place.size_px) << scale;
    EXPECT_NEAR(result.face.window.size_px, place.size_px, 0.06F * place.size_px) << scale;
  }
}

TEST_F(LandmarkerTest, DoesNotJumpToAnotherFaceWhenItsOwnIsHidden) {
  const auto picture = [&](bool own) {
    cv::Mat canvas(700, 1920, CV_8UC3, cv::Scalar(100, 100, 100));
    photo(cv::Rect(1450, 200, 300, 480)).copyTo(canvas(cv::Rect(1500, 100, 300, 480)));
    if (own) {
      photo(cv::Rect(1010, 150, 340, 480)).copyTo(canvas(cv::Rect(100, 100, 340, 480)));
    }
    return frame_of(canvas);
  };
  const LandmarkResult& result = landmarker->process(picture(true));
  ASSERT_TRUE(result.found);
  ASSERT_LT(result.face.window.centre_px.x(), 500);
  for (int i = 0; i < 8; ++i) {
    EXPECT_FALSE(landmarker->process(picture(false)).found);
    EXPECT_EQ(result.frames_without_face, i + 1);
  }
  landmarker->process(picture(true));
  EXPECT_TRUE(result.found);
  EXPECT_TRUE(result.acquired);
  EXPECT_LT(result.face.window.centre_px.x(), 500);
  // After a while anyone may be the one.
  int waited = 0;
  while (!landmarker->process(picture(false)).found && waited < 100) {
    ++waited;
  }
  EXPECT_GT(result.face.window.centre_px.x(), 1400);
  EXPECT_GT(waited, 10);
  EXPECT_LT(waited, 60);
}

TEST_F(LandmarkerTest, ReportsNoFaceWhereThereIsNone) {
  cv::theRNG().state = 42;
  cv::Mat noise(480, 640, CV_8UC3);
  cv::randu(noise, 0, 255);
  cv::Mat blotches;
  cv::GaussianBlur(noise, blotches, {}, 12);
  cv::normalize(blotches, blotches, 0, 255, cv::NORM_MINMAX);
  // Clothes, hands and background of the photograph.
  const cv::Mat bodies = photo(cv::Rect(0, 750, 1920, 600)).clone();
  for (const cv::Mat& picture : {noise, blotches, bodies, cv::Mat(480, 640, CV_8UC3, cv::Scalar(0, 0, 0))}) {
    landmarker->forget();
    const Frame frame = frame_of(picture);
    for (int i = 0; i < 20; ++i) {
      ASSERT_FALSE(landmarker->process(frame).found) << i;
    }
    EXPECT_TRUE(landmarker->find_all(frame).empty());
  }
}

TEST_F(LandmarkerTest, LosesAFaceThatIsCoveredAndFindsItInTheNextFrame) {
  const Frame frame = frame_of(photo);
  for (const bool live : {false, true}) {
    Landmarker follower(test::landmark_nets(), {.live = live});
    const LandmarkResult& result = follower.process(frame);
    ASSERT_TRUE(result.found);
    cv::Mat covered = photo.clone();
    const auto centre = result.face.window.centre_px;
    const int half = static_cast<int>(0.5F * result.face.window.size_px);
    cv::rectangle(covered, {static_cast<int>(centre.x()) - half, static_cast<int>(centre.y()) - half},
                  {static_cast<int>(centre.x()) + half, static_cast<int>(centre.y()) + half},
                  cv::Scalar(150, 150, 150), cv::FILLED);
    const Frame without = frame_of(covered);
    // With a check of the detector begun, answered, or about to begin.
    for (int followed = 0; followed < 24; ++followed) {
      follower.process(without);
      EXPECT_FALSE(result.found);
      follower.process(frame);
      EXPECT_TRUE(result.found);
      for (int i = 0; i < followed; ++i) {
        follower.process(frame);
        ASSERT_TRUE(result.found);
        ASSERT_FALSE(result.acquired);
      }
    }
  }
}

TEST_F(LandmarkerTest, ASequenceGivesTheSameBitsInEveryRun) {
  const cv::Size canvas(900, 900);
  std::vector<Frame> frames;
  for (int i = 0; i < 30; ++i) {
    frames.push_back(frame_of(warped(solo, view(1 + 0.01 * i, 0.02 * i, canvas), canvas)));
  }
  std::vector<FaceLandmarks> first;
  for (int run = 0; run < 3; ++run) {
    Landmarker follower(test::landmark_nets());
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const LandmarkResult& result = follower.process(frames[i]);
      ASSERT_TRUE(result.found) << i;
      if (run == 0) {
        first.push_back(result.face);
        continue;
      }
      ASSERT_EQ(result.face.points_px, first[i].points_px) << i;
      ASSERT_EQ(result.face.irises_px, first[i].irises_px) << i;
    }
  }
}

TEST_F(LandmarkerTest, TakesFramesOfAnyKind) {
  const LandmarkResult& result = landmarker->process(Frame{});
  EXPECT_FALSE(result.found);
  for (const cv::Size size : {cv::Size(1, 1), cv::Size(16, 16), cv::Size(641, 3), cv::Size(13, 127)}) {
    cv::Mat tiny;
    cv::resize(photo, tiny, size, 0, 0, cv::INTER_AREA);
    landmarker->process(frame_of(tiny));
    EXPECT_FALSE(result.found) << size;
  }
  Frame corrupt = frame_of(photo);
  corrupt.corrupt = true;
  EXPECT_FALSE(landmarker->process(corrupt).found);
  EXPECT_EQ(result.frames_without_face, 6);
}

TEST_F(LandmarkerTest, FindsTheFaceInGreyAndInOddSizes) {
  cv::Mat grey;
  cv::cvtColor(solo, grey, cv::COLOR_BGR2GRAY);
  cv::cvtColor(grey, grey, cv::COLOR_GRAY2BGR);
  const auto in_colour = landmarker->process(frame_of(solo)).face;
  landmarker->forget();
  const LandmarkResult& result = landmarker->process(frame_of(grey));
  ASSERT_TRUE(result.found);
  EXPECT_LT(error(result.face, in_colour.points_px.topRows<2>()), 0.05F);
  landmarker->forget();
  ASSERT_TRUE(landmarker->process(frame_of(solo(cv::Rect(31, 17, 401, 555)).clone())).found);
  EXPECT_LT(error(result.face, in_colour.points_px.topRows<2>().colwise() - Eigen::Vector2f(31, 17)), 0.03F);
}

TEST_F(LandmarkerTest, FindsTheFaceInAnEightKFrame) {
  cv::Mat large;
  cv::resize(photo, large, cv::Size(7680, 5400), 0, 0, cv::INTER_LINEAR);
  const auto reference = landmarker->process(frame_of(photo)).face;
  landmarker->forget();
  const LandmarkResult& result = landmarker->process(frame_of(large));
  ASSERT_TRUE(result.found);
  const cv::Matx23d between(4, 0, 1.5, 0, 4, 1.5);
  EXPECT_LT(error(result.face, carried(between, reference.points_px)), 0.03F);
}

TEST_F(LandmarkerTest, FollowsAFaceHalfOutOfTheImage) {
  const cv::Mat crop = photo(cv::Rect(1010, 100, 700, 600)).clone();
  const auto reference = landmarker->process(frame_of(crop)).face;
  const LandmarkResult* result = nullptr;
  // The face's centre line reaches the left border at 170.
  for (int shift = 0; shift <= 170; shift += 10) {
    result = &landmarker->process(frame_of(crop(cv::Rect(shift, 0, 700 - shift, 600)).clone()));
    ASSERT_TRUE(result->found) << shift;
    ASSERT_FALSE(result->acquired) << shift;
  }
  int hidden = 0;
  float squared = 0;
  int seen = 0;
  for (int i = 0; i < landmark_count; ++i) {
    if (result->face.points_px(0, i) < -1) {
      EXPECT_EQ(result->face.confidence[i], 0) << i;
      ++hidden;
    } else if (result->face.confidence[i] > 0.5F) {
      squared += (result->face.points_px.col(i).head<2>() + Eigen::Vector2f(170, 0) -
                  reference.points_px.col(i).head<2>())
                     .squaredNorm();
      ++seen;
    }
  }
  EXPECT_GT(hidden, 100);
  EXPECT_GT(seen, 100);
  EXPECT_LT(std::sqrt(squared / static_cast<float>(seen)) / result->face.interocular_px, 0.12F);
}

TEST_F(LandmarkerTest, TrustsWhatFacesTheCamera) {
  const auto faces = landmarker->find_all(frame_of(photo));
  ASSERT_FALSE(faces.empty());
  for (const FaceLandmarks& face : faces) {
    EXPECT_GT(face.confidence.minCoeff(), -1e-6F);
    EXPECT_LT(face.confidence.maxCoeff(), 1 + 1e-6F);
    constexpr int nose_tip = 1;
    EXPECT_GT(face.confidence[nose_tip], 0.9F);
  }
}

}  // namespace
}  // namespace facet::landmark
