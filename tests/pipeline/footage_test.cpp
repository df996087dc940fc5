// The pipeline with its real stages on a real clip that something is wrong with: each is compared with the
// clip as it is.

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <optional>

#include "film.hpp"
#include "simulation/actor_sequence.hpp"

namespace facet::pipeline {
namespace {

using mesh::TrackingState;
using render::Picture;

constexpr int kFrames = 30;
constexpr float kFaceWidth_px = 100;
// In the clip's first picture.
constexpr float kMouthY_px = 205;
constexpr float kEyesY_px = 156;
constexpr float kForeheadY_px = 122;

class Footage : public Film {
 protected:
  /// How far the meshes of a disturbed film are from those of the clip as it is.
  struct Difference {
    int meshes = 0;
    float mean_percent = 0;   ///< distance of the face's control vertices in the picture, of the face's width
    float worst_percent = 0;  ///< of a frame
    float relief = 0;  ///< rms displacement beside that of the clip as it is; 1 where nothing is refined
  };

  void SetUp() override {
    Film::SetUp();
    if (IsSkipped()) {
      return;
    }
    person_ = read("cap12_edit", kFrames);
    if (!as_it_is().has_value()) {
      film(kClipWidth_px, kFrames, [&](Picture& onto, int f) { onto = person(f); });
      const Frames frames = run();
      ASSERT_EQ(static_cast<int>(frames.size()), kFrames);
      for (const auto& frame : frames) {
        ASSERT_TRUE(has_mesh(*frame)) << frame->sequence;
      }
      as_it_is() = frames;
    }
  }

  const Picture& person(int frame) const { return person_[static_cast<std::size_t>(frame)]; }

  /// Every pixel of a frame; channels 0 to 255, cut to that range afterwards.
  static void change(Picture& picture,
                     const std::function<Eigen::Array3f(int x, int y, Eigen::Array3f rgb)>& to) {
    for (int y = 0; y < picture.height_px; ++y) {
      for (int x = 0; x < picture.width_px; ++x) {
        std::uint8_t* const pixel =
            picture.rgb.data() + 3 * static_cast<std::size_t>(y * picture.width_px + x);
        const Eigen::Array3f rgb = to(
            x, y, {static_cast<float>(pixel[0]), static_cast<float>(pixel[1]), static_cast<float>(pixel[2])});
        for (int c = 0; c < 3; ++c) {
          pixel[c] = static_cast<std::uint8_t>(std::lround(std::clamp(rgb[c], 0.0F, 255.0F)));
        }
      }
    }
  }

  /// Light on linear values, as a lamp or an exposure changes it.
  static Eigen::Array3f lit(const Eigen::Array3f& rgb, const Eigen::Array3f& gain) {
    return 255 * ((rgb / 255).pow(2.2F) * gain).min(1.0F).pow(1 / 2.2F);
  }

  /// scale, offset: from a place in the clip's picture to the film's; step: of the clip's frames that are
  /// shown.
  static Difference compare(const Frames& frames, float scale = 1, Eigen::Vector2f offset_px = {0, 0},
                            int step = 1) {
    Difference out;
    double squares = 0;
    double squares_as_it_is = 0;
    for (const auto& frame : frames) {
      expect_plausible(*frame);
      const mesh::MeshFrame& expected =
          *as_it_is()->at(static_cast<std::size_t>(frame->sequence) * static_cast<std::size_t>(step));
      if (!has_mesh(*frame)) {
        continue;
      }
      const auto seen_px = [](const mesh::MeshFrame& of, Eigen::Index v) {
        const Eigen::Vector3f p = of.camera_from_head * of.control_vertices_mm.col(v);
        return Eigen::Vector2f(of.camera.fx * p.x() / p.z() + of.camera.cx,
                               of.camera.fy * p.y() / p.z() + of.camera.cy);
      };
      float sum = 0;
      int count = 0;
      for (Eigen::Index v = 0; v < expected.control_vertices_mm.cols(); ++v) {
        if (face::has_region(expected.subject->regions[static_cast<std::size_t>(v)],
                             face::Region::Refinable)) {
          sum += (seen_px(*frame, v) - scale * seen_px(expected, v) - offset_px).norm();
          ++count;
        }
      }
      const float percent = 100 * sum / static_cast<float>(count) / (scale * kFaceWidth_px);
      ++out.meshes;
      out.mean_percent += percent;
      out.worst_percent = std::max(out.worst_percent, percent);
      const auto add = [](const std::vector<float>& displacements_mm, double& to) {
        double own = 0;
        for (const float d : displacements_mm) {
          own += static_cast<double>(d * d);
        }
        to += displacements_mm.empty() ? 0 : own / static_cast<double>(displacements_mm.size());
      };
      add(frame->displacements_mm, squares);
      add(expected.displacements_mm, squares_as_it_is);
    }
    out.mean_percent /= static_cast<float>(std::max(out.meshes, 1));
    out.relief = squares_as_it_is > 0 ? static_cast<float>(std::sqrt(squares / squares_as_it_is)) : 1;
    return out;
  }

  /// Films the clip with a change of each picture and runs it.
  Difference disturbed(const std::function<void(Picture& picture, int frame)>& change_picture) {
    film(kClipWidth_px, kFrames, [&](Picture& onto, int f) {
      onto = person(f);
      change_picture(onto, f);
    });
    return compare(run());
  }

 private:
  static std::optional<Frames>& as_it_is() {
    static std::optional<Frames> frames;
    return frames;
  }
  std::vector<Picture> person_;
};

TEST_F(Footage, AHandBeforeTheMouth) {
  const Difference found = disturbed([](Picture& picture, int f) {
    if (f < 8 || f >= 20) {
      return;
    }
    // A palm and four fingers across, a little darker between them.
    for (int finger = 0; finger < 5; ++finger) {
      const float y = kMouthY_px - 16 + 9 * static_cast<float>(finger);
      for (float x = 170; x < 262; x += 1.5F) {
        render::draw_dot(picture, {x, y}, 5.5F, {176, 122, 102});
      }
      render::draw_line(picture, {170, y + 4.5F}, {262, y + 4.5F}, {120, 76, 62}, 0.8F);
    }
  });
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 4.0F);
  EXPECT_LT(found.relief, 1.2F);
}

TEST_F(Footage, HairOverTheForehead) {
  const Difference found = disturbed([](Picture& picture, int) {
    for (int strand = 0; strand < 14; ++strand) {
      const float x = 172 + 5 * static_cast<float>(strand);
      for (int thread = 0; thread < 3; ++thread) {
        const auto beside = static_cast<float>(thread);
        render::draw_line(picture, {x + beside, 88},
                          {x + beside + 6 * std::sin(x), kForeheadY_px + 16 + 8 * std::cos(3 * x)},
                          {42, 30, 24}, 0.9F);
      }
    }
  });
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 1.0F);
  EXPECT_LT(found.relief, 1.2F);
}

TEST_F(Footage, Glasses) {
  const Difference found = disturbed([](Picture& picture, int) {
    const auto ring = [&](float middle_x) {
      for (float a = 0; a < 2 * std::numbers::pi_v<float>; a += 0.03F) {
        render::draw_dot(picture, {middle_x + 17 * std::cos(a), kEyesY_px + 13 * std::sin(a)}, 1.6F,
                         {20, 18, 18});
      }
      // What the glass mirrors.
      render::draw_line(picture, {middle_x - 9, kEyesY_px + 5}, {middle_x + 4, kEyesY_px - 8},
                        {245, 248, 255}, 0.9F);
      render::draw_line(picture, {middle_x - 6, kEyesY_px + 6}, {middle_x + 7, kEyesY_px - 7},
                        {245, 248, 255}, 0.9F);
    };
    ring(188);
    ring(233);
    render::draw_line(picture, {204, kEyesY_px - 2}, {217, kEyesY_px - 2}, {20, 18, 18}, 1);
  });
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 3.0F);
  EXPECT_LT(found.relief, 1.25F);  // a rim has more of a say since the robust bound is 0.6
}

TEST_F(Footage, LightFromOneSide) {
  const Difference found = disturbed([](Picture& picture, int) {
    change(picture, [](int x, int, Eigen::Array3f rgb) {
      const float across = std::clamp((static_cast<float>(x) - 155) / kFaceWidth_px, 0.0F, 1.0F);
      return lit(rgb, Eigen::Array3f::Constant(0.12F + 1.3F * across));
    });
  });
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 1.0F);
  EXPECT_LT(found.relief, 1.4F);
}

TEST_F(Footage, ALampIsSwitchedOn) {
  const Difference found = disturbed([](Picture& picture, int f) {
    change(picture, [&](int x, int, Eigen::Array3f rgb) {
      const float across = std::clamp((255 - static_cast<float>(x)) / kFaceWidth_px, 0.0F, 1.0F);
      return f < 12 ? rgb : lit(rgb, 1 + across * Eigen::Array3f(1.6F, 1.2F, 0.7F));
    });
  });
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 0.5F);
  EXPECT_LT(found.relief, 1.2F);
}

TEST_F(Footage, TheExposureHunts) {
  const Difference found = disturbed([](Picture& picture, int f) {
    const float gain = std::exp2(1.2F * std::sin(2 * std::numbers::pi_v<float> * static_cast<float>(f) / 10));
    const float warm = 0.15F * std::sin(static_cast<float>(f) / 3);
    change(picture, [&](int, int, Eigen::Array3f rgb) {
      return lit(rgb, gain * Eigen::Array3f(1 + warm, 1, 1 - warm));
    });
  });
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 0.5F);
  EXPECT_LT(found.relief, 1.2F);
}

TEST_F(Footage, MotionBlur) {
  const Difference found = disturbed([](Picture& picture, int f) {
    const int reach_px = f >= 8 && f < 16 ? 8 : 0;
    const Picture sharp = picture;
    change(picture, [&](int x, int y, Eigen::Array3f) {
      Eigen::Array3f sum = Eigen::Array3f::Zero();
      for (int dx = -reach_px; dx <= reach_px; ++dx) {
        const std::size_t at =
            3 * static_cast<std::size_t>(y * sharp.width_px + std::clamp(x + dx, 0, sharp.width_px - 1));
        sum += Eigen::Array3f(sharp.rgb[at], sharp.rgb[at + 1], sharp.rgb[at + 2]);
      }
      return Eigen::Array3f(sum / static_cast<float>(2 * reach_px + 1));
    });
  });
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 4.0F);
  EXPECT_LT(found.relief, 1.2F);
}

TEST_F(Footage, HalfTheRate) {
  film(
      kClipWidth_px, kFrames / 2, [&](Picture& onto, int f) { onto = person(2 * f); }, kClipHeight_px, 12);
  const Difference found = compare(run(), 1, {0, 0}, 2);
  EXPECT_EQ(found.meshes, kFrames / 2);
  EXPECT_LT(found.worst_percent, 0.5F);
  EXPECT_LT(found.relief, 1.2F);
}

TEST_F(Footage, Interlaced) {
  const Difference found = disturbed([this](Picture& picture, int f) {
    const Picture& next = person(std::min(f + 1, kFrames - 1));
    for (int y = 1; y < picture.height_px; y += 2) {
      const auto row = static_cast<std::ptrdiff_t>(3 * y * picture.width_px);
      std::copy_n(next.rgb.begin() + row, 3 * picture.width_px, picture.rgb.begin() + row);
    }
  });
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 1.0F);
  EXPECT_LT(found.relief, 1.2F);
}

TEST_F(Footage, AFaceOfSixtyPixels) {
  constexpr float kScale = 0.6F;
  const Eigen::Vector2f corner_px(120, 90);
  film(kClipWidth_px, kFrames, [&](Picture& onto, int f) {
    const Picture small = render::resize(person(f), static_cast<int>(kScale * kClipWidth_px),
                                         static_cast<int>(kScale * kClipHeight_px));
    render::paste(onto, small, static_cast<int>(corner_px.x()), static_cast<int>(corner_px.y()));
  });
  const Difference found = compare(run(), kScale, corner_px);
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 1.5F);
  EXPECT_LT(found.relief, 1.3F);
}

TEST_F(Footage, AFaceThatFillsThePicture) {
  constexpr int kLeft_px = 140;
  constexpr int kTop_px = 98;
  constexpr int kWidth_px = 134;
  constexpr int kHeight_px = 134;
  constexpr int kScale = 4;
  film(
      kScale * kWidth_px, kFrames,
      [&](Picture& onto, int f) {
        onto = render::resize(render::crop(person(f), kLeft_px, kTop_px, kWidth_px, kHeight_px),
                              kScale * kWidth_px, kScale * kHeight_px);
      },
      kScale * kHeight_px);
  const Difference found = compare(run(), kScale, Eigen::Vector2f(-kScale * kLeft_px, -kScale * kTop_px));
  EXPECT_EQ(found.meshes, kFrames);
  EXPECT_LT(found.worst_percent, 2.0F);
  EXPECT_LT(found.relief, 1.8F);
}

TEST_F(Footage, APhotoHeldUp) {
  film(kClipWidth_px, kFrames, [&](Picture& onto, int) { onto = person(3); });
  const Frames frames = run();
  ASSERT_EQ(static_cast<int>(frames.size()), kFrames);
  for (const auto& frame : frames) {
    expect_plausible(*frame);
    ASSERT_TRUE(has_mesh(*frame)) << frame->sequence;
  }
  const auto moved_mm = [&](std::size_t f) {
    return (frames[f]->camera_from_head * frames[f]->control_vertices_mm -
            frames[f - 1]->camera_from_head * frames[f - 1]->control_vertices_mm)
        .colwise()
        .norm()
        .maxCoeff();
  };
  EXPECT_LT(moved_mm(frames.size() - 1), 0.002F) << "it comes to rest";
}

TEST_F(Footage, AWrongFocalLength) {
  for (const float focal_px : {150.0F, 1200.0F}) {
    config_.tracker.intrinsics =
        CameraIntrinsics{focal_px, focal_px, 199.5F, 149.5F, kClipWidth_px, kClipHeight_px};
    const Difference found = disturbed([](Picture&, int) {});
    EXPECT_EQ(found.meshes, kFrames) << focal_px;
    EXPECT_LT(found.worst_percent, 2.0F);
    EXPECT_LT(found.relief, 1.3F);
  }
}

TEST_F(Footage, AHeadThatTurnsBySeventyDegreesAndBack) {
  constexpr int kTurnFrames = 40;
  const auto model = face::FaceModel::load(config_.model_file);
  simulation::ActorSequenceConfig studio_config;
  studio_config.seed = 5;
  studio_config.width_px = 400;
  studio_config.height_px = 300;
  studio_config.frame_count = kTurnFrames;
  studio_config.rays_per_pixel = 1;
  studio_config.turn_deg = 70;
  const simulation::ActorSequence studio(model, studio_config);
  std::vector<Eigen::Isometry3f> true_pose;
  film(400, kTurnFrames, [&](Picture& onto, int f) {
    simulation::SyntheticFrame frame = studio.render(f, nullptr);
    onto = std::move(frame.picture);
    true_pose.push_back(frame.camera_from_head);
  });
  const Frames frames = run();
  ASSERT_EQ(static_cast<int>(frames.size()), kTurnFrames);
  const auto degrees = [](const Eigen::Matrix3f& turn) {
    return Eigen::AngleAxisf(turn).angle() * 180 / std::numbers::pi_v<float>;
  };
  float most_deg = 0;
  for (const auto& frame : frames) {
    expect_plausible(*frame);
    const auto f = static_cast<std::size_t>(frame->sequence);
    const Eigen::Matrix3f turned = (true_pose[f] * true_pose[0].inverse()).linear();
    const float turned_deg = degrees(turned);
    most_deg = std::max(most_deg, turned_deg);
    if (turned_deg < 45 && f < kTurnFrames / 2) {
      ASSERT_TRUE(has_mesh(*frame)) << turned_deg;
    }
    if (has_mesh(*frame)) {
      const Eigen::Matrix3f found =
          (frame->camera_from_head * frames[0]->camera_from_head.inverse()).linear();
      EXPECT_LT(degrees(found * turned.transpose()), 8) << f << ", turned by " << turned_deg;
    }
  }
  EXPECT_GT(most_deg, 65) << "or the test shows nothing";
  EXPECT_EQ(frames.back()->state, TrackingState::Tracking);
  EXPECT_EQ(status_.subjects, 1U);
}

TEST_F(Footage, TwoFacesSwapPlaces) {
  // The first passes before the second.
  const auto other = read("cap13_edit2", kFrames);
  constexpr int kPath_px = 150;
  const auto shift_px = [](int f) { return kPath_px * std::clamp(f - 6, 0, 18) / 18; };
  constexpr int kLeft_px = 140;
  constexpr int kCrop_px = 140;
  film(kClipWidth_px, kFrames, [&](Picture& onto, int f) {
    render::paste(onto, render::crop(other[static_cast<std::size_t>(f)], kLeft_px, 60, kCrop_px, 240),
                  230 - shift_px(f), 60);
    render::paste(onto, render::crop(person(f), kLeft_px, 60, kCrop_px, 240), 30 + shift_px(f), 60);
  });
  const Frames frames = run();
  for (const auto& frame : frames) {
    expect_plausible(*frame);
    ASSERT_TRUE(has_mesh(*frame)) << frame->sequence;
    const auto at_px = static_cast<float>(68 + 30 + shift_px(static_cast<int>(frame->sequence)));
    EXPECT_NEAR(seen_at_px(*frame), at_px, 12) << frame->sequence << ": it stays with the first";
  }
  EXPECT_EQ(status_.subjects, 1U);
}

}  // namespace
}  // namespace facet::pipeline
