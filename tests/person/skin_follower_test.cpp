#include "person/skin_follower.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <random>
#include <thread>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "maths/srgb.hpp"
#include "mesh/quads.hpp"
#include "mesh/triangle_points.hpp"
#include "person/skin_motion.hpp"
#include "person/surface_anchor.hpp"
#include "support/synthetic_model.hpp"

namespace facet::person {
namespace {

constexpr int kSide = 200;  ///< of the skin's chart, texels
constexpr int kWidthPx = 480;
constexpr int kHeightPx = 480;

/// A face with freckles that its model knows, and pictures of it under a light that its model does not know.
class SkinFollowerTest : public ::testing::Test {
 protected:
  SkinFollowerTest() : model_(test::synthetic_model(41)) {
    model_.skin.width = model_.skin.height = kSide;
    model_.skin.texels_per_unit = kSide - 1;
    model_.skin.relief_mm.assign(std::size_t{kSide} * kSide, 0);
    model_.skin.albedo.assign(3 * model_.skin.relief_mm.size(), 0.4F);
    std::mt19937 random(7);
    std::uniform_int_distribution<int> place(2, kSide - 3);
    for (int freckle = 0; freckle < 900; ++freckle) {
      const int x = place(random);
      const int y = place(random);
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dx = -1; dx <= 1; ++dx) {
          std::fill_n(model_.skin.albedo.begin() + 3 * ((y + dy) * kSide + x + dx), 3, 0.2F);
        }
      }
    }
    tracked_.state = mesh::TrackingState::Tracking;
    tracked_.has_mesh = true;
    tracked_.camera = {900, 900, kWidthPx / 2.0F, kHeightPx / 2.0F, kWidthPx, kHeightPx};
    tracked_.camera_from_head = Eigen::Isometry3f::Identity();
    tracked_.camera_from_head.linear() = Eigen::Vector3f(1, -1, -1).asDiagonal();
    tracked_.camera_from_head.translation() << 0, 0, 600;
    tracked_.vertices_mm = model_.core_row(0, 0);
  }

  /// What the camera shows of a face with these vertices. light  brightness by place in the picture
  template <typename Light>
  Frame picture(const mesh::Vertices& vertices_mm, Light&& light) {
    return picture(tracked_.camera_from_head, vertices_mm, std::forward<Light>(light));
  }
  template <typename Light>
  Frame picture(const Eigen::Isometry3f& camera_from_head, const mesh::Vertices& vertices_mm, Light&& light) {
    mesh::Vertices surface_mm;
    mesh::apply(surface_rows(model_), vertices_mm, surface_mm);
    const mesh::Vertices camera_mm = camera_from_head * surface_mm;
    const mesh::Triangles triangles = mesh::split_quads(model_.control.quads);
    pixels_.assign(std::size_t{4} * kWidthPx * kHeightPx, 128);
    const auto px = [&](std::int32_t v) -> Eigen::Vector2f {
      return 900 * camera_mm.col(v).head<2>() / camera_mm(2, v) +
             Eigen::Vector2f(kWidthPx / 2.0F, kHeightPx / 2.0F);
    };
    std::vector<float> nearest(std::size_t{kWidthPx} * kHeightPx, 1e9F);
    for (Eigen::Index t = 0; t < triangles.cols(); ++t) {
      const auto corners = triangles.col(t);
      mesh::for_each_point(
          px(corners[0]), px(corners[1]), px(corners[2]), kWidthPx, kHeightPx,
          [&](int x, int y, const Eigen::Vector3f& share) {
            const auto at = static_cast<std::size_t>(y * kWidthPx + x);
            const float depth = share[0] * camera_mm(2, corners[0]) + share[1] * camera_mm(2, corners[1]) +
                                share[2] * camera_mm(2, corners[2]);
            if (depth < nearest[at]) {
              nearest[at] = depth;
              const mesh::TextureCoordinates coordinates =
                  model_.control.texture_coordinates(Eigen::all, corners) * share;
              const float albedo =
                  face::albedo_at(model_.skin, coordinates, Eigen::Vector3f::Constant(0.4F))(0, 0);
              const float value = maths::encode_srgb(std::clamp(light(x, y) * albedo, 0.0F, 1.0F));
              std::fill_n(pixels_.begin() + static_cast<std::ptrdiff_t>(4 * at), 3,
                          static_cast<std::uint8_t>(std::lround(255 * value)));
            }
          });
    }
    Frame out;
    out.width_px = kWidthPx;
    out.height_px = kHeightPx;
    out.stride_bytes = 4 * kWidthPx;
    out.pixels = std::shared_ptr<const std::uint8_t[]>(pixels_.data(), [](const std::uint8_t*) {});
    return out;
  }

  static float side_light(int x, int y) {
    return 0.9F + 0.8F * static_cast<float>(x) / kWidthPx + 0.2F * static_cast<float>(y) / kHeightPx;
  }

  /// The tracked face as the skin really lies: on the surface beside where the tracker has it.
  mesh::Vertices slid(float mm) const {
    mesh::Vertices out = tracked_.vertices_mm;
    for (Eigen::Index v = 0; v < out.cols(); ++v) {
      const Eigen::Vector3f p = out.col(v);
      const float share = std::exp(-(p - Eigen::Vector3f(25, -20, p.z())).squaredNorm() / (2 * 25 * 25));
      out.col(v) += mm * share * Eigen::Vector3f(0.8F, 0.6F, 0);
    }
    return out;
  }

  /// Mean distance of what shading refines, in the picture's plane. least_mm  of the vertices that the
  /// tracker has so far from the truth
  double off_mm(const mesh::Vertices& found, const mesh::Vertices& truth, float least_mm = 0) const {
    double sum = 0;
    int count = 0;
    for (Eigen::Index v = 0; v < found.cols(); ++v) {
      const bool middle = truth.col(v).head<2>().cwiseAbs().maxCoeff() < 50 &&
                          (tracked_.vertices_mm.col(v) - truth.col(v)).norm() >= least_mm;
      if (model_.control.refinable[static_cast<std::size_t>(v)] != 0 && middle) {
        sum += static_cast<double>((found.col(v) - truth.col(v)).head<2>().norm());
        ++count;
      }
    }
    return sum / count;
  }

  double off_mm(const FollowedHead& found, const mesh::Vertices& truth, float least_mm = 0) const {
    const mesh::Vertices in_tracked_head =
        tracked_.camera_from_head.inverse() * found.camera_from_head * found.vertices_mm;
    return off_mm(in_tracked_head, truth, least_mm);
  }

  face::FaceModel model_;
  track::TrackResult tracked_;
  std::vector<std::uint8_t> pixels_;
};

TEST_F(SkinFollowerTest, TheMeshSlidesToWhereItsSkinIs) {
  SkinFollower follower(model_);
  const mesh::Vertices truth = slid(3);
  FollowedHead found;
  const double known = follower.follow(picture(truth, side_light), tracked_, found);
  EXPECT_GT(known, 0.5);
  EXPECT_LT(off_mm(found, truth, 1.5F), 0.9);
  EXPECT_GT(off_mm(tracked_.vertices_mm, truth, 1.5F), 2);
}

TEST_F(SkinFollowerTest, ThePoseFollowsAHeadThatWasTrackedBesideItself) {
  SkinFollower follower(model_);
  Eigen::Isometry3f really = tracked_.camera_from_head;
  really.rotate(Eigen::AngleAxisf(0.02F, Eigen::Vector3f::UnitY()));
  really.pretranslate(Eigen::Vector3f(1.5F, -1, 0));
  const auto off = [&](const Eigen::Isometry3f& camera_from_head, const mesh::Vertices& vertices_mm) {
    return off_mm(camera_from_head * vertices_mm, really * tracked_.vertices_mm);
  };
  FollowedHead found;
  follower.follow(picture(really, tracked_.vertices_mm, side_light), tracked_, found);
  const double before = off(tracked_.camera_from_head, tracked_.vertices_mm);
  EXPECT_GT(before, 1);
  EXPECT_LT(off(found.camera_from_head, found.vertices_mm), before / 5);
  EXPECT_LT(off(found.camera_from_head, tracked_.vertices_mm), before / 3) << "the pose alone";
  EXPECT_NEAR(found.camera_from_head.translation().z(), really.translation().z(), 1.5F);

  // Two cameras have said where it is.
  tracked_.view_used = {1, 1};
  follower.follow(picture(really, tracked_.vertices_mm, side_light), tracked_, found);
  EXPECT_TRUE(found.camera_from_head.isApprox(tracked_.camera_from_head));
}

/// A hand before one half of a face that lies beside where it was tracked: the other half is followed.
TEST_F(SkinFollowerTest, WhatStandsBeforeTheFaceLeadsNowhere) {
  SkinFollower follower(model_);
  const auto covered = [](int x, int y) {
    const int finger = (x / 14 * 7 + y / 18 * 13) % 5;
    return x < 240 ? 0.3F + 0.2F * static_cast<float>(finger) : side_light(x, y);
  };
  FollowedHead found;
  const double known = follower.follow(picture(tracked_.vertices_mm, covered), tracked_, found);
  EXPECT_GT(known, 0.15) << "the other half";
  EXPECT_LT(off_mm(found, tracked_.vertices_mm), 0.25);

  Eigen::Isometry3f really = tracked_.camera_from_head;
  really.pretranslate(Eigen::Vector3f(1.5F, -1, 0));
  follower.follow(picture(really, tracked_.vertices_mm, covered), tracked_, found);
  const mesh::Vertices truth =
      tracked_.camera_from_head.inverse() * really * mesh::Vertices(tracked_.vertices_mm);
  EXPECT_LT(off_mm(found, truth), 0.5 * off_mm(tracked_.vertices_mm, truth));
}

/// A few points beside a hand move the head less than a whole face that says the same.
TEST(SkinMotion, LittleSkinMovesTheHeadLittle) {
  SeenSkin skin{Eigen::Matrix3Xf(3, 9), Eigen::Matrix3Xf(3, 9), Eigen::VectorXf::Ones(9)};
  for (int i = 0; i < 9; ++i) {
    skin.tracked_mm.col(i) << static_cast<float>(i % 3 * 10), static_cast<float>(i / 3 * 10), 600;
    skin.seen_mm.col(i) = skin.tracked_mm.col(i) + Eigen::Vector3f(1, 0, 0);
  }
  const CameraIntrinsics camera{900, 900, 240, 240, 480, 480};
  const auto moved_mm = [&](float whole) {
    skin.whole = whole;
    return (motion_of(skin, camera) * skin.tracked_mm - skin.tracked_mm).row(0).mean();
  };
  EXPECT_NEAR(moved_mm(9), 1, 0.1F);
  EXPECT_LT(moved_mm(90000), 0.5F);
  skin.weight.setZero();
  EXPECT_TRUE(motion_of(skin, camera).isApprox(Eigen::Isometry3f::Identity()));
}

/// Shows a picture until a look at it has ended beside the frames: how long that takes is the machine's
/// affair. Returns the first head and the last one.
std::pair<FollowedHead, FollowedHead> follow_until_seen(SkinFollower& follower, const Frame& picture,
                                                        const track::TrackResult& tracked) {
  std::pair<FollowedHead, FollowedHead> out;
  EXPECT_EQ(follower.follow(picture, tracked, out.first), 0) << "the frame waits for nothing";
  for (int frame = 0; frame < 60'000; ++frame) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    if (follower.follow(picture, tracked, out.second) > 0) {
      return out;
    }
  }
  ADD_FAILURE() << "no look ended within a minute";
  return out;
}

/// Beside the frames the mesh comes there by and by, and stays there in between.
TEST_F(SkinFollowerTest, LooksBesideTheFramesAndComesThereByAndBy) {
  SkinFollower follower(model_, SkinFollower::Pace::Beside);
  const mesh::Vertices truth = slid(3);
  auto [first, found] = follow_until_seen(follower, picture(truth, side_light), tracked_);
  EXPECT_EQ(first.vertices_mm, tracked_.vertices_mm);
  std::vector<double> off{off_mm(tracked_.vertices_mm, truth, 1.5F)};
  for (int frame = 0; frame < 12; ++frame) {
    off.push_back(off_mm(found, truth, 1.5F));
    EXPECT_LT(off[off.size() - 1], off[off.size() - 2]);
    follower.follow(Frame{}, tracked_, found);
  }
  EXPECT_GT(off[1], off.front() / 2) << "no jump";
  EXPECT_LT(off.back(), 1.2);
}

TEST_F(SkinFollowerTest, WhoWasAwayIsLookedAtAnew) {
  SkinFollower follower(model_, SkinFollower::Pace::Beside);
  const Frame slid_away = picture(slid(3), side_light);
  FollowedHead found = follow_until_seen(follower, slid_away, tracked_).second;
  EXPECT_GT((found.vertices_mm - tracked_.vertices_mm).norm(), 1);
  follower.forget();
  follower.follow(Frame{}, tracked_, found);
  EXPECT_EQ(found.vertices_mm, tracked_.vertices_mm);
  EXPECT_TRUE(found.camera_from_head.isApprox(tracked_.camera_from_head));
  found = follow_until_seen(follower, slid_away, tracked_).second;  // it does not wait for the tenth
  EXPECT_GT((found.vertices_mm - tracked_.vertices_mm).norm(), 1);

  // What was looked at before says nothing of who comes.
  follower.forget();
  follower.follow(slid_away, tracked_, found);
  follower.forget();
  found = follow_until_seen(follower, picture(tracked_.vertices_mm, side_light), tracked_).second;
  EXPECT_LT(off_mm(found, tracked_.vertices_mm), 0.1);
}

TEST_F(SkinFollowerTest, WhatLiesRightStaysInAnyLight) {
  SkinFollower follower(model_);
  FollowedHead found;
  for (const float strength : {0.3F, 1.0F}) {
    follower.follow(picture(tracked_.vertices_mm, [&](int x, int y) { return strength * side_light(x, y); }),
                    tracked_, found);
    EXPECT_LT(off_mm(found, tracked_.vertices_mm), 0.1) << strength;
  }
}

/// The edge of a shadow is no skin that moves.
TEST_F(SkinFollowerTest, AShadowLeadsNowhere) {
  SkinFollower follower(model_);
  FollowedHead found;
  const auto shaded = [](int x, int y) { return side_light(x, y) * (x + y / 2 < 340 ? 0.35F : 1.0F); };
  follower.follow(picture(tracked_.vertices_mm, shaded), tracked_, found);
  EXPECT_LT(off_mm(found, tracked_.vertices_mm), 0.15);
}

TEST_F(SkinFollowerTest, SkinThatIsNotKnownAgainStays) {
  SkinFollower follower(model_);
  std::mt19937 random(11);
  for (float& value : model_.skin.albedo) {
    value = std::uniform_real_distribution<float>(0.1F, 0.6F)(random);
  }
  FollowedHead found;
  const double known = follower.follow(picture(tracked_.vertices_mm, side_light), tracked_, found);
  EXPECT_LT(known, 0.2);
  EXPECT_LT(off_mm(found, tracked_.vertices_mm), 0.15);
}

TEST_F(SkinFollowerTest, BadInputIsSurvived) {
  SkinFollower follower(model_);
  FollowedHead found;
  const Frame dark = picture(tracked_.vertices_mm, [](int, int) { return 0.0F; });
  EXPECT_LT(follower.follow(dark, tracked_, found), 0.1);
  EXPECT_EQ(found.vertices_mm, tracked_.vertices_mm);
  EXPECT_TRUE(found.camera_from_head.isApprox(tracked_.camera_from_head));
  track::TrackResult away = tracked_;
  away.camera_from_head.translation() << 5000, 0, 600;
  EXPECT_EQ(follower.follow(dark, away, found), 0);
  EXPECT_EQ(found.vertices_mm, away.vertices_mm);
  EXPECT_TRUE(found.camera_from_head.isApprox(away.camera_from_head));
  model_.skin.albedo.clear();
  EXPECT_THROW(SkinFollower{model_}, Error);
}

}  // namespace
}  // namespace facet::person
