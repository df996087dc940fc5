#include "landmark/face_check.hpp"

#include <gtest/gtest.h>

#include <thread>

#include "facet/error.hpp"
#include "landmark/landmark_assets.hpp"
#include "landmark/landmarker.hpp"
#include "support/frames.hpp"

namespace facet::landmark {
namespace {

/// The nets, a photograph, and where its faces are.
class FaceCheckTest : public testing::Test {
 protected:
  void SetUp() override {
    const cv::Mat photo = test::read_photo("sample3.jpg");
    if (!std::filesystem::exists(test::landmark_nets()) || photo.empty()) {
      GTEST_SKIP() << test::landmark_nets() << " or the photographs are missing (packaging/fetch-assets)";
    }
    frame = test::frame_of(photo);
    faces = Landmarker(test::landmark_nets()).find_all(frame);
    ASSERT_GE(faces.size(), 2U);
    const LandmarkAssets assets = LandmarkAssets::load(test::landmark_nets());
    check = std::make_unique<FaceCheck>(assets.detector(), "detector", 0.6F);
  }

  Frame frame;
  std::vector<FaceLandmarks> faces;
  std::unique_ptr<FaceCheck> check;
};

TEST_F(FaceCheckTest, IsAnsweredWhileItsAskerDoesOtherThings) {
  for (const FaceLandmarks& face : faces) {
    check->ask(frame, face.window);
    EXPECT_TRUE(check->pending());
    while (!check->ready()) {  // nobody waits for it: the helper does it
      std::this_thread::yield();
    }
    const std::optional<Region> seen = check->answer();
    EXPECT_FALSE(check->pending());
    ASSERT_TRUE(seen.has_value());
    EXPECT_LT((seen->centre_px - face.window.centre_px).norm(), 0.25F * face.window.size_px);
  }
}

TEST_F(FaceCheckTest, WhoWaitsGetsTheSameAnswer) {
  check->ask(frame, faces.front().window);
  while (!check->ready()) {
    std::this_thread::yield();
  }
  const Region helped = check->answer().value();
  for (int i = 0; i < 20; ++i) {
    check->ask(frame, faces.front().window);
    const Region seen = check->answer().value();
    ASSERT_EQ(seen.centre_px, helped.centre_px);
    ASSERT_EQ(seen.size_px, helped.size_px);
    ASSERT_EQ(seen.rotation_rad, helped.rotation_rad);
  }
}

TEST_F(FaceCheckTest, KeepsNoFrameAndNoQuestionThatWasDropped) {
  check->ask(frame, faces[0].window);
  check->drop();
  EXPECT_FALSE(check->pending());
  check->ask(frame, faces[1].window);
  const std::optional<Region> seen = check->answer();
  ASSERT_TRUE(seen.has_value());
  EXPECT_LT((seen->centre_px - faces[1].window.centre_px).norm(), 0.25F * faces[1].window.size_px)
      << "the answer to the second question";
  EXPECT_EQ(frame.pixels.use_count(), 1) << "the camera gets its buffer back";
}

TEST_F(FaceCheckTest, SeesNothingWhereNobodyIs) {
  const cv::Mat wall(480, 640, CV_8UC3, cv::Scalar(100, 110, 120));
  check->ask(test::frame_of(wall), {{320, 240}, 200, 0});
  EXPECT_FALSE(check->answer().has_value());
}

}  // namespace
}  // namespace facet::landmark
