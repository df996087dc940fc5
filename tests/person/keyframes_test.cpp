#include "person/keyframes.hpp"

#include <gtest/gtest.h>

#include <array>
#include <memory>
#include <numbers>

#include "support/synthetic_model.hpp"

namespace facet::person {
namespace {

class KeyframesTest : public ::testing::Test {
 protected:
  KeyframesTest() : model_(test::synthetic_model(21)), collector_(model_) {
    frame_.width_px = 640;
    frame_.height_px = 480;
    frame_.stride_bytes = 4 * 640;
    const std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[4 * 640 * 480]);
    std::fill_n(pixels.get(), 4 * 640 * 480, std::uint8_t{90});
    frame_.pixels = pixels;
    tracked_.state = mesh::TrackingState::Tracking;
    tracked_.has_mesh = true;
    tracked_.subject = 1;
    tracked_.camera = {800, 800, 319.5F, 239.5F, 640, 480};
    tracked_.identity.assign(static_cast<std::size_t>(model_.identity_count()), 0);
    tracked_.expression.assign(static_cast<std::size_t>(model_.expression_count()), 0);
    tracked_.vertices_mm = model_.core_row(0, 0);
    tracked_.reprojection_px = 1;
  }

  void show(float yaw_deg, float smile, double seconds) {
    const float radians = yaw_deg * std::numbers::pi_v<float> / 180;
    tracked_.camera_from_head = Eigen::Isometry3f::Identity();
    tracked_.camera_from_head.linear() =
        Eigen::Vector3f(1, -1, -1).asDiagonal() *
        Eigen::AngleAxisf(-radians, Eigen::Vector3f::UnitY()).toRotationMatrix();
    tracked_.camera_from_head.translation() = Eigen::Vector3f(0, 0, 600);
    tracked_.expression[static_cast<std::size_t>(model_.expression_index("mouthSmileLeft"))] = smile;
    frame_.sequence = sequence_++;
    frame_.media_time_ns = static_cast<std::int64_t>(seconds * 1e9);
    collector_.offer(tracked_, frame_);
  }

  face::FaceModel model_;
  KeyframeCollector collector_;
  Frame frame_;
  track::TrackResult tracked_;
  std::uint64_t sequence_ = 0;
};

TEST_F(KeyframesTest, TheCalmestPictureOfAnOrientationIsKept) {
  show(0, 0, 0);
  show(12, 0.6F, 1);
  show(12, 0.05F, 2);
  show(12, 0.7F, 3);
  show(0, 0, 4);
  show(0, 0, 5);
  show(24, 0.9F, 6);  // it acts: no picture of the face at rest
  const auto observed = collector_.observed(10);
  ASSERT_TRUE(observed);
  ASSERT_EQ(observed->keyframes.size(), 2U);
  EXPECT_EQ(observed->keyframes[1].sequence, 2U);
  EXPECT_NEAR(observed->keyframes[1].yaw_deg, 12, 0.01);
  EXPECT_NEAR(collector_.span().largest_yaw, 24, 0.01);
  const HeadPicture& picture = observed->keyframes[1].picture;
  EXPECT_EQ(picture.rgb.size(),
            static_cast<std::size_t>(picture.width_px) * static_cast<std::size_t>(picture.height_px) * 3);
  EXPECT_GT(picture.width_px, 150);
  EXPECT_LT(picture.width_px, 400);
}

TEST_F(KeyframesTest, ABlurredHeadIsPassedOver) {
  show(0, 0, 0);
  show(20, 0, 0.05);  // 400 degrees a second
  EXPECT_EQ(collector_.filled().size(), 1U);
}

TEST_F(KeyframesTest, AnotherSubjectBeginsAnew) {
  show(0, 0, 0);
  show(20, 0, 1);
  tracked_.subject = 2;
  show(-20, 0, 2);
  const auto observed = collector_.observed(10);
  ASSERT_TRUE(observed);
  ASSERT_EQ(observed->keyframes.size(), 1U);
  EXPECT_NEAR(observed->keyframes[0].yaw_deg, -20, 0.01);
}

TEST_F(KeyframesTest, WhereTheyAreDenseTheyAreThinnedOut) {
  for (int i = 0; i <= 10; ++i) {
    show(static_cast<float>(4 * i), 0, i);
  }
  const auto observed = collector_.observed(4);
  ASSERT_TRUE(observed);
  ASSERT_EQ(observed->keyframes.size(), 4U);
  double nearest = 1e9;
  for (std::size_t i = 1; i < 4; ++i) {
    nearest =
        std::min(nearest, std::abs(observed->keyframes[i].yaw_deg - observed->keyframes[i - 1].yaw_deg));
  }
  EXPECT_GE(nearest, 7.9);
}

TEST_F(KeyframesTest, OfABurstEveryLightIsTakenAndNoSwitching) {
  show(0, 0, 0);
  // Of three lights (from the left, the right, from below) three pictures each, and after them one in which
  // the lamp was switched; in the last one of each light the person blinks away or smiles.
  const auto show_light = [&](float left, float right, float low, float smile) {
    const std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[4 * 640 * 480]);
    for (int y = 0; y < 480; ++y) {
      for (int x = 0; x < 640; ++x) {
        const float value = 40 + (x < 320 ? left : right) + (y < 240 ? 0 : low);
        std::fill_n(pixels.get() + 4 * (640 * y + x), 4, static_cast<std::uint8_t>(value));
      }
    }
    frame_.pixels = pixels;
    tracked_.expression[static_cast<std::size_t>(model_.expression_index("mouthSmileLeft"))] = smile;
    frame_.sequence = sequence_++;
    collector_.offer_lit(tracked_, frame_);
  };
  sequence_ = 0;
  const std::array<std::array<float, 3>, 3> lights{{{150, 0, 0}, {0, 150, 0}, {0, 0, 150}}};
  const std::array<std::array<float, 3>, 3> switching{{{75, 75, 0}, {0, 75, 75}, {75, 0, 75}}};
  for (std::size_t light = 0; light < 3; ++light) {
    for (int i = 0; i < 3; ++i) {
      show_light(lights[light][0], lights[light][1], lights[light][2], i == 2 ? 0.9F : 0);
    }
    show_light(switching[light][0], switching[light][1], switching[light][2], 0);
  }
  EXPECT_TRUE(collector_.observed(10)->burst.empty()) << "it was not asked for";
  for (const int most : {3, 100}) {
    const auto observed = collector_.observed(10, most);
    ASSERT_TRUE(observed);
    EXPECT_EQ(observed->light_count(), 3);
    EXPECT_EQ(observed->burst.size(), most == 3 ? 3U : 6U);
    std::array<int, 3> light_of{0, 0, 0};
    for (const Keyframe& keyframe : observed->burst) {
      EXPECT_LT(keyframe.sequence % 4, 2U) << "the lamp was switched, or the face was not at rest";
      int& light = light_of.at(keyframe.sequence / 4);
      EXPECT_TRUE(light == 0 || light == keyframe.light) << "one light has one number";
      light = keyframe.light;
    }
  }
  tracked_.subject = 2;  // somebody else
  show(0, 0, 9);
  EXPECT_TRUE(collector_.observed(10, 100)->burst.empty());
}

TEST_F(KeyframesTest, WhereNoLampIsSwitchedThereIsNoBurst) {
  show(0, 0, 0);
  for (int i = 0; i < 6; ++i) {
    collector_.offer_lit(tracked_, frame_);
  }
  EXPECT_EQ(collector_.observed(10, 100)->light_count(), 0);
}

TEST_F(KeyframesTest, WithoutAMeshNothingIsKept) {
  tracked_.state = mesh::TrackingState::Acquiring;
  show(0, 0, 0);
  EXPECT_EQ(collector_.size(), 0U);
  EXPECT_FALSE(collector_.observed(5));
}

TEST_F(KeyframesTest, WhereNoPictureShowsTheFaceAtRestThereIsNone) {
  show(0, 1, 0);
  for (int i = 1; i < 5; ++i) {
    show(i % 2 == 0 ? 0 : 30, 0, 0.01 * i);  // at rest, and blurred
  }
  EXPECT_EQ(collector_.filled().size(), 1U);
  EXPECT_FALSE(collector_.observed(10));
}

}  // namespace
}  // namespace facet::person
