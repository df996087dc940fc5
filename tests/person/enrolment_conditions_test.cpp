// Turns as operators film them: what is in the way must not end in a wrong face that is believed.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <random>
#include <tuple>
#include <utility>

#include "actors_turn.hpp"
#include "facet/assets.hpp"
#include "person/enrolment.hpp"
#include "person/improved_person.hpp"

namespace facet::person {
namespace {

constexpr std::uint64_t kMadeUp = 353;  ///< a person who wears make-up

/// The small pictures are learned from in half the time; an enrolment takes three rounds.
EnrolmentOptions quick() {
  EnrolmentOptions options;
  options.rounds = 2;
  options.chart_texels = 448;
  options.uncertainty = false;
  options.skin = false;
  return options;
}

/// A picture's pixel by place, in between and outside black.
Eigen::Vector3f sample(const HeadPicture& picture, float x, float y) {
  const int left = static_cast<int>(std::floor(x));
  const int top = static_cast<int>(std::floor(y));
  Eigen::Vector3f out = Eigen::Vector3f::Zero();
  for (int j = 0; j < 2; ++j) {
    for (int i = 0; i < 2; ++i) {
      const int column = left + i;
      const int row = top + j;
      if (column >= 0 && row >= 0 && column < picture.width_px && row < picture.height_px) {
        const float weight =
            (1 - std::abs(x - static_cast<float>(column))) * (1 - std::abs(y - static_cast<float>(row)));
        const std::uint8_t* pixel =
            picture.rgb.data() + 3 * (static_cast<std::ptrdiff_t>(row) * picture.width_px + column);
        out += weight * Eigen::Vector3f(pixel[0], pixel[1], pixel[2]);
      }
    }
  }
  return out;
}

/// The picture whose pixel (x, y) shows what `from` shows at place(x, y).
HeadPicture warped(const HeadPicture& from, const std::function<Eigen::Vector2f(float, float)>& place) {
  HeadPicture out = from;
  for (int y = 0; y < from.height_px; ++y) {
    for (int x = 0; x < from.width_px; ++x) {
      const Eigen::Vector2f at = place(static_cast<float>(x), static_cast<float>(y));
      const Eigen::Vector3f colour = sample(from, at.x(), at.y());
      for (int c = 0; c < 3; ++c) {
        out.rgb[static_cast<std::size_t>(3 * (y * from.width_px + x) + c)] =
            static_cast<std::uint8_t>(std::lround(colour[c]));
      }
    }
  }
  return out;
}

class EnrolmentConditions : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
#ifndef FACET_SANITIZED
    if (std::filesystem::exists(default_model_file())) {
      model_ = std::make_unique<face::FaceModel>(face::FaceModel::load(default_model_file()));
      actor_ = std::make_unique<simulation::ActorSequence>(*model_, actors_turn());
      plain_ = look_at(*model_, *actor_);
    }
#endif
  }
  static void TearDownTestSuite() {
    actor_.reset();
    model_.reset();
  }

  void SetUp() override {
#ifdef FACET_SANITIZED
    GTEST_SKIP() << "minutes under a sanitizer; the parts have tests of their own";
#endif
    if (!model_) {
      GTEST_SKIP() << "no " << default_model_file() << ": facet model build makes it";
    }
  }

  static LearnedShape learn(const Observed& observed) {
    return learn_shape(*model_, observed, quick(), {});
  }

  static Eigen::Matrix3Xd mean_face() {
    return model_->core_row(0, 0).cast<double>();
  }

  /// The shape is accepted, and nearer to the truth than the mean face by a fifth at least.
  static void expect_learned(const LearnedShape& learned, const simulation::TruthMesh& neutral) {
    const report::Truth truth(neutral);
    EXPECT_TRUE(learned.accepted) << learned.refused;
    EXPECT_LT(error_mm(*model_, learned.neutral_mm, truth), 0.8 * error_mm(*model_, mean_face(), truth));
  }

  static inline std::unique_ptr<face::FaceModel> model_;
  static inline std::unique_ptr<simulation::ActorSequence> actor_;
  static inline Observed plain_;
};

/// A camera that mirrors shows another head, no wrong one.
TEST_F(EnrolmentConditions, AMirrorImageIsAFaceToo) {
  Observed mirrored = plain_;
  mirrored.camera.cx = static_cast<float>(actors_turn().width_px) - 1 - mirrored.camera.cx;
  const Eigen::DiagonalMatrix<double, 3> flip(-1, 1, 1);
  for (Keyframe& keyframe : mirrored.keyframes) {
    const float last = static_cast<float>(keyframe.picture.width_px - 1);
    keyframe.picture =
        warped(keyframe.picture, [&](float x, float y) { return Eigen::Vector2f(last - x, y); });
    keyframe.camera_from_head.linear() = flip * keyframe.camera_from_head.linear() * flip;
    keyframe.camera_from_head.translation().x() *= -1;
    std::tie(keyframe.yaw_deg, keyframe.pitch_deg) = orientation_deg(keyframe.camera_from_head);
  }
  simulation::TruthMesh neutral = actor_->neutral();
  neutral.vertices_mm.row(0) *= -1;
  neutral.normals.row(0) *= -1;
  neutral.triangles.row(1).swap(neutral.triangles.row(2));
  expect_learned(learn(mirrored), neutral);
}

/// The lamps are dimmed to a third while the head turns.
TEST_F(EnrolmentConditions, LightThatChangesIsNoShape) {
  Observed dimmed = plain_;
  for (std::size_t k = 0; k < dimmed.keyframes.size(); ++k) {
    const double light = 1 - 0.67 * static_cast<double>(k) / static_cast<double>(dimmed.keyframes.size() - 1);
    for (std::uint8_t& value : dimmed.keyframes[k].picture.rgb) {
      value = static_cast<std::uint8_t>(std::lround(value * std::pow(light, 1 / 2.2)));
    }
  }
  expect_learned(learn(dimmed), actor_->neutral());
}

/// One lens for all pictures is what the solve believes in; what it makes of a zoom is the focal length's.
TEST_F(EnrolmentConditions, AZoomLensIsNoShape) {
  Observed zoomed = plain_;
  for (std::size_t k = 0; k < zoomed.keyframes.size(); ++k) {
    Keyframe& keyframe = zoomed.keyframes[k];
    const float zoom = 1 + 0.25F * static_cast<float>(k) / static_cast<float>(zoomed.keyframes.size() - 1);
    const Eigen::Vector2f middle(zoomed.camera.cx, zoomed.camera.cy);
    keyframe.picture = warped(keyframe.picture, [&](float x, float y) {
      return Eigen::Vector2f(middle + (Eigen::Vector2f(x, y) - middle) / zoom);
    });
    keyframe.camera_from_head.translation().z() /= static_cast<double>(zoom);
  }
  expect_learned(learn(zoomed), actor_->neutral());
}

/// A photo that somebody turns before the camera has no depth.
TEST_F(EnrolmentConditions, APhotoTurnedByHandIsRefused) {
  Observed photo = plain_;
  const CameraIntrinsics camera = plain_.camera;
  Eigen::Matrix3d lens = Eigen::Matrix3d::Identity();
  lens(0, 0) = lens(1, 1) = static_cast<double>(camera.fx);
  lens(0, 2) = static_cast<double>(camera.cx);
  lens(1, 2) = static_cast<double>(camera.cy);
  const double depth = mean_face().row(2).maxCoeff() - 30;  // between the nose and the ears
  const auto from_plane = [&](const Eigen::Isometry3d& pose) {
    Eigen::Matrix3d plane;
    plane << pose.linear().leftCols<2>(), pose * Eigen::Vector3d(0, 0, depth);
    return Eigen::Matrix3d(lens * plane);
  };
  const auto frontal = std::min_element(
      photo.keyframes.begin(), photo.keyframes.end(),
      [](const Keyframe& a, const Keyframe& b) { return std::abs(a.yaw_deg) < std::abs(b.yaw_deg); });
  const HeadPicture print = frontal->picture;
  const Eigen::Matrix3d printed = from_plane(frontal->camera_from_head);
  for (Keyframe& keyframe : photo.keyframes) {
    const Eigen::Matrix3f back = (printed * from_plane(keyframe.camera_from_head).inverse()).cast<float>();
    keyframe.picture = warped(print, [&](float x, float y) {
      return Eigen::Vector2f((back * Eigen::Vector3f(x, y, 1)).hnormalized());
    });
  }
  const LearnedShape learned = learn(photo);
  EXPECT_FALSE(learned.accepted);
  EXPECT_THAT(learned.refused, ::testing::HasSubstr("flat"));
}

/// A fringe of dark hair hangs before the forehead and goes with the head.
TEST_F(EnrolmentConditions, HairOverTheForeheadIsNoShape) {
  Observed fringed = plain_;
  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(0, 1);
  const Eigen::Matrix3Xd face = mean_face();
  const double top = face.row(1).maxCoeff();
  std::vector<Eigen::Vector3d> hair;
  for (int strand = 0; strand < 500; ++strand) {
    // From the hairline down to the brows, a few millimetres before the skin under it.
    const double x = 110 * (uniform(random) - 0.5);
    const double lean = 16 * (uniform(random) - 0.5);
    const double end = 25 + 25 * uniform(random);
    for (double down = 0; down < end; down += 0.5) {
      const Eigen::Vector2d at(x + lean * down / end, top - down);
      Eigen::Index nearest = 0;
      (face.topRows<2>().colwise() - at).colwise().squaredNorm().minCoeff(&nearest);
      hair.emplace_back(at.x(), at.y(), face(2, nearest) + 5);
    }
  }
  for (Keyframe& keyframe : fringed.keyframes) {
    for (const Eigen::Vector3d& point : hair) {
      const Eigen::Vector3d seen = keyframe.camera_from_head * point;
      const int x =
          static_cast<int>(std::lround(static_cast<double>(fringed.camera.fx) * seen.x() / seen.z() +
                                       static_cast<double>(fringed.camera.cx)));
      const int y =
          static_cast<int>(std::lround(static_cast<double>(fringed.camera.fy) * seen.y() / seen.z() +
                                       static_cast<double>(fringed.camera.cy)));
      if (x >= 0 && y >= 0 && x < keyframe.picture.width_px && y < keyframe.picture.height_px) {
        std::fill_n(keyframe.picture.rgb.begin() +
                        3 * (static_cast<std::ptrdiff_t>(y) * keyframe.picture.width_px + x),
                    3, std::uint8_t{30});
      }
    }
  }
  expect_learned(learn(fringed), actor_->neutral());
}

TEST_F(EnrolmentConditions, GlassesAreNoShape) {
  simulation::ActorSequenceConfig config = actors_turn();
  config.glasses = true;
  expect_learned(learn(look_at(*model_, simulation::ActorSequence(*model_, config))), actor_->neutral());
}

/// Who wears them in one session and not in the other is the same head; another actor, who is enrolled under
/// that name by mistake, is not.
TEST_F(EnrolmentConditions, GlassesBetweenSessionsAreTheSameHeadAndAnotherActorIsNot) {
  const auto enrolled = [](const simulation::ActorSequenceConfig& config) {
    const Observed observed = look_at(*model_, simulation::ActorSequence(*model_, config));
    EnrolmentOptions options = quick();
    options.uncertainty = true;
    return person_of(*model_, observed, learn_shape(*model_, observed, options, {}));
  };
  simulation::ActorSequenceConfig config = actors_turn();
  const PersonFile without = enrolled(config);
  config.glasses = true;
  config.light = simulation::LightKind::Area;
  const ImprovedPerson same = improved(*model_, without, enrolled(config));
  EXPECT_TRUE(same.same_head) << same.disagreement;
  config = actors_turn();
  config.seed = 77;
  const ImprovedPerson other = improved(*model_, without, enrolled(config));
  EXPECT_FALSE(other.same_head) << other.disagreement;
  EXPECT_GT(other.disagreement, same.disagreement);
}

/// Every row of a webcam's picture has a time of its own, and moves while it is exposed.
TEST_F(EnrolmentConditions, ARollingShutterIsSlowEnough) {
  simulation::ActorSequenceConfig config = actors_turn();
  config.webcam.rolling_shutter = true;
  config.webcam.motion_blur = true;
  config.webcam.exposure = true;
  config.webcam.white_balance = true;
  expect_learned(learn(look_at(*model_, simulation::ActorSequence(*model_, config))), actor_->neutral());
}

/// Who talks while turning, of all of whose pictures none was passed over (KeyframesTest: most are): what is
/// made of them is nearer than the guess.
TEST_F(EnrolmentConditions, TalkingWhileTurningDoesNoHarm) {
  simulation::ActorSequenceConfig config = actors_turn();
  config.calm_turn = false;
  config.turn_deg = 35;
  config.frame_count = 200;
  const simulation::ActorSequence actor(*model_, config);
  const Observed talking = look_at(*model_, actor, {22, 40, 118, 124, 130, 148, 178, 184, 190});
  double moved = 0;
  for (const Keyframe& keyframe : talking.keyframes) {
    moved = std::max(moved, keyframe.expression.norm());
  }
  ASSERT_GT(moved, 1) << "this one keeps still";
  const LearnedShape learned = learn(talking);
  ASSERT_TRUE(learned.accepted) << learned.refused;
  const report::Truth truth(actor.neutral());
  EXPECT_LT(error_mm(*model_, learned.neutral_mm, truth), error_mm(*model_, mean_face(), truth));
}

/// Painted lips, cheeks and lids move with the skin, as freckles and moles do.
TEST_F(EnrolmentConditions, MakeUpIsNoShape) {
  simulation::ActorSequenceConfig config = actors_turn();
  config.person = kMadeUp;
  config.look.skin_type = 2;
  const simulation::ActorSequence actor(*model_, config);
  config.look.makeup = false;
  ASSERT_GT((actor.neutral().albedo - simulation::ActorSequence(*model_, config).neutral().albedo)
                .cwiseAbs()
                .maxCoeff(),
            0.05F)
      << "this one wears none";
  expect_learned(learn(look_at(*model_, actor)), actor.neutral());
}

}  // namespace
}  // namespace facet::person
