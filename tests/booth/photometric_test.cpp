#include "booth/photometric.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "fit/fine_surface.hpp"
#include "render/renderer.hpp"
#include "support/synthetic_model.hpp"

namespace facet::booth {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr int kSide_px = 320;

capture::Lens lens_at(double angle_rad) {
  capture::Lens lens;
  lens.width_px = lens.height_px = kSide_px;
  lens.fx_px = lens.fy_px = 1400;
  lens.cx_px = lens.cy_px = 159.5;
  Eigen::Matrix3d upright;  // looks along -z, y down
  upright << 1, 0, 0, 0, -1, 0, 0, 0, -1;
  lens.camera_from_rig = Eigen::Translation3d(0, 0, 900) * Eigen::Isometry3d(Eigen::Quaterniond(upright)) *
                         Eigen::AngleAxisd(angle_rad, Vector3d::UnitY());
  return lens;
}

/// Two cameras, a projector on either side, a lamp above and one below.
std::shared_ptr<const capture::Rig> lit_rig() {
  auto rig = std::make_shared<capture::Rig>();
  rig->cameras = {{"left", lens_at(-0.2), true}, {"right", lens_at(0.2), false}};
  rig->projectors = {{"projector-l", lens_at(-0.5)}, {"projector-r", lens_at(0.5)}};
  rig->lights = {{"top", {0, 600, 700}, 1}, {"low", {0, -600, 700}, 1}};
  return rig;
}

/// A template whose skin has wrinkles of 12 mm along y and a texture, as the rig's cameras see it.
struct Scene {
  Scene() : model(test::synthetic_model()), rig(lit_rig()) {
    surface = std::make_shared<const fit::TemplateMesh>(fit::make_template(model, 3000));
    fit::FineOptions options;
    options.sweeps = 3;
    hierarchy = fit::FineSurface(model.control, surface, options).hierarchy();
    mesh::Vertices flat_mm;
    mesh::apply(hierarchy->finest().from_coarser, surface->neutral_mm, flat_mm);
    for (Eigen::Index v = 0; v < flat_mm.cols(); ++v) {
      wrinkles_mm.push_back(0.2F * std::sin(flat_mm(1, v) * 2 * 3.14159F / 12));
      albedo.push_back(0.5F + 0.2F * std::sin(flat_mm(0, v) * 0.7F) * std::sin(flat_mm(1, v) * 0.9F));
    }
    mesh::rebuild_finest(*hierarchy, surface->neutral_mm, wrinkles_mm, vertices_mm, normals);
  }

  /// What a slot's lights show: near lamps with shadows, one strength each.
  FrameSet slot(std::uint64_t number, const std::vector<std::pair<Vector3f, float>>& lamps) const {
    FrameSet set;
    set.slot = number;
    const mesh::Triangles& triangles = hierarchy->finest().triangles;
    const render::Raycaster world(vertices_mm, triangles);
    for (const capture::RigCamera& camera : rig->cameras) {
      const Eigen::Isometry3f pose = camera.lens.camera_from_rig.cast<float>();
      const mesh::Vertices seen = (pose.linear() * vertices_mm).colwise() + pose.translation();
      const render::HitImage hits =
          render::Raycaster(seen, triangles).cast({1400, 1400, 159.5F, 159.5F, kSide_px, kSide_px});
      const std::shared_ptr<std::uint8_t[]> pixels(new std::uint8_t[4 * kSide_px * kSide_px]());
      for (std::size_t i = 0; i < static_cast<std::size_t>(kSide_px) * kSide_px; ++i) {
        if (hits.triangle[i] < 0) {
          continue;
        }
        const auto at = [&](const Eigen::Matrix3Xf& field) {
          return render::interpolate(triangles, hits.triangle[i], hits.barycentric[i], field);
        };
        const Vector3f place_mm = at(vertices_mm);
        const Vector3f normal = at(normals).normalized();
        float light = 0;
        for (const auto& [lamp_mm, strength] : lamps) {
          const Vector3f way = lamp_mm - place_mm;
          const float cosine = normal.dot(way.normalized());
          if (cosine > 0 && !world.occluded(place_mm + 0.5F * normal, lamp_mm, 0)) {
            light += strength * cosine * 1e6F / way.squaredNorm();
          }
        }
        const auto corner = triangles.col(hits.triangle[i]);
        const Vector3f parts(1 - hits.barycentric[i].sum(), hits.barycentric[i].x(), hits.barycentric[i].y());
        float grey = 0;
        for (Eigen::Index k = 0; k < 3; ++k) {
          grey += parts[k] * albedo[static_cast<std::size_t>(corner[k])];
        }
        const std::uint8_t value = render::linear_to_srgb8(std::min(0.9F, 0.5F * grey * light));
        std::fill_n(pixels.get() + 4 * i, 3, value);
        pixels.get()[4 * i + 3] = 255;
      }
      Frame& frame = set.frames.emplace_back();
      frame.width_px = frame.height_px = kSide_px;
      frame.stride_bytes = 4 * kSide_px;
      frame.pixels = pixels;
    }
    return set;
  }

  /// Of what was found with the wrinkles, where skin faces the cameras: correlation, and depth as a share.
  std::pair<double, double> compare(const std::vector<float>& found_mm) const {
    double aa = 0, ab = 0, bb = 0;
    for (std::size_t v = 0; v < found_mm.size(); ++v) {
      if (normals(2, static_cast<Eigen::Index>(v)) > 0.8F) {
        aa += static_cast<double>(wrinkles_mm[v] * wrinkles_mm[v]);
        ab += static_cast<double>(wrinkles_mm[v] * found_mm[v]);
        bb += static_cast<double>(found_mm[v] * found_mm[v]);
      }
    }
    return {ab / std::sqrt(std::max(aa * bb, 1e-12)), ab / aa};
  }

  face::FaceModel model;
  std::shared_ptr<const capture::Rig> rig;
  std::shared_ptr<const fit::TemplateMesh> surface;
  std::shared_ptr<const mesh::Hierarchy> hierarchy;
  std::vector<float> wrinkles_mm, albedo;
  mesh::Vertices vertices_mm;
  Eigen::Matrix3Xf normals;
};

class Photometric : public testing::Test {
 protected:
  static void SetUpTestSuite() { scene_ = std::make_unique<Scene>(); }
  static void TearDownTestSuite() { scene_.reset(); }

  static Vector3f lamp(const char* name) {
    for (const capture::RigLight& light : scene_->rig->lights) {
      if (light.name == name) {
        return light.position_mm.cast<float>();
      }
    }
    return Vector3f::Zero();
  }
  static FrameSet blank() {
    return scene_->slot(2, {{scene_->rig->projectors[0].lens.centre_mm().cast<float>(), 0.5F},
                            {scene_->rig->projectors[1].lens.centre_mm().cast<float>(), 0.5F}});
  }
  static std::unique_ptr<PhotometricStereo> begun() {
    auto stereo = std::make_unique<PhotometricStereo>(scene_->rig, PhotometricOptions());
    stereo->begin(scene_->hierarchy, *scene_->surface);
    return stereo;
  }
  static std::string refine(PhotometricStereo& stereo, const FrameSet& even, std::span<const LitSlot> lit) {
    const std::vector<float> by_depth(scene_->wrinkles_mm.size(), 0.0F);
    return stereo.refine(even, lit, scene_->surface->neutral_mm, scene_->surface->neutral_mm, by_depth,
                         added_);
  }

  static std::unique_ptr<Scene> scene_;
  static inline std::vector<float> added_;
};
std::unique_ptr<Scene> Photometric::scene_;

// Wrinkles across the way from lamp to lamp, under a texture that nobody knows.
TEST_F(Photometric, LampsAboveAndBelowTellWrinklesFromTexture) {
  const FrameSet even = blank();
  const FrameSet top = scene_->slot(5, {{lamp("top"), 1.0F}});
  const FrameSet low = scene_->slot(8, {{lamp("low"), 1.3F}});  // brighter than the rig file says
  const std::array<LitSlot, 2> lit{{{&top, 0.3, {"top"}}, {&low, 0.6, {"low"}}}};
  const auto stereo = begun();
  EXPECT_EQ(refine(*stereo, even, lit), "");
  const auto [correlation, depth] = scene_->compare(added_);
  EXPECT_GT(correlation, 0.85);
  EXPECT_GT(depth, 0.5);
  EXPECT_LT(depth, 1.2);
  EXPECT_NEAR(stereo->strength_of("low") / stereo->strength_of("top"), 1.3, 0.13);
}

// The even light of blank slots alone can't: nothing is added where no slot is lit.
TEST_F(Photometric, WithoutLitSlotsNothingIsAdded) {
  const auto stereo = begun();
  EXPECT_EQ(refine(*stereo, blank(), {}), "");
  EXPECT_THAT(added_, testing::Each(0.0F));
}

TEST_F(Photometric, ASlotThatAnotherLightLitIsToldAndLeftOut) {
  const FrameSet even = blank();
  FrameSet wrong = scene_->slot(5, {{lamp("low"), 1.0F}});
  wrong.light = "light:top";
  const std::array<LitSlot, 1> lit{{{&wrong, 0.5, {"top"}}}};
  const auto stereo = begun();
  EXPECT_THAT(refine(*stereo, even, lit),
              testing::AllOf(testing::HasSubstr("slot 5"), testing::HasSubstr("light:top")));
  EXPECT_THAT(added_, testing::Each(0.0F));

  // A lamp that is out: room light alone.
  FrameSet out = blank();
  out.slot = 8;
  out.light = "light:top";
  const std::array<LitSlot, 1> as_blank{{{&out, 0.5, {"top"}}}};
  EXPECT_THAT(refine(*begun(), even, as_blank), testing::HasSubstr("slot 8"));
}

// A lamp that is out for a moment is told, and seen by again when it is back.
TEST_F(Photometric, ALampThatWasOutIsBelievedAgain) {
  const FrameSet even = blank();
  const FrameSet top = scene_->slot(5, {{lamp("top"), 1.0F}});
  const FrameSet low = scene_->slot(8, {{lamp("low"), 1.0F}});
  FrameSet out = scene_->slot(8, {});
  out.light = "light:low";
  const std::array<LitSlot, 2> lit{{{&top, 0.3, {"top"}}, {&low, 0.6, {"low"}}}};
  const std::array<LitSlot, 2> without{{{&top, 0.3, {"top"}}, {&out, 0.6, {"low"}}}};
  for (const bool first_out : {false, true}) {
    const auto stereo = begun();
    if (!first_out) {
      EXPECT_EQ(refine(*stereo, even, lit), "");
    }
    EXPECT_THAT(refine(*stereo, even, without), testing::HasSubstr("slot 8"));
    EXPECT_EQ(refine(*stereo, even, lit), "");
    EXPECT_GT(scene_->compare(added_).first, 0.85);
  }
}

// A dark slot tells the room's light, which is in all the others.
TEST_F(Photometric, ADarkSlotTellsTheRoomsLight) {
  const Vector3f window_mm(0, 0, 3000);  // so far away that it lights all alike: 10 %
  const auto with_room = [&](std::uint64_t slot, std::vector<std::pair<Vector3f, float>> lamps) {
    lamps.emplace_back(window_mm, 0.9F);
    return scene_->slot(slot, lamps);
  };
  const FrameSet even = with_room(2, {{scene_->rig->projectors[0].lens.centre_mm().cast<float>(), 0.5F},
                                      {scene_->rig->projectors[1].lens.centre_mm().cast<float>(), 0.5F}});
  const FrameSet top = with_room(5, {{lamp("top"), 1.0F}});
  const FrameSet dark = with_room(6, {});
  const std::array<LitSlot, 2> lit{{{&top, 0.3, {"top"}}, {&dark, 0.6, {}}}};
  const auto stereo = begun();
  EXPECT_EQ(refine(*stereo, even, lit), "");
  // In the measure of a projector's light in the blank slot, 0.5 at 1 m, from 900 mm.
  EXPECT_NEAR(stereo->ambient(), 0.1 / (0.5 / 0.81), 0.03);
}

// Room light of a twelfth of the lamps, switched on and off within a take, is no relief: it is fitted with
// them.
TEST_F(Photometric, RoomLightThatIsSwitchedIsNoRelief) {
  const auto stereo = begun();
  for (const float room : {0.0F, 0.85F, 0.0F}) {
    const std::pair<Vector3f, float> bulb(Vector3f(-1500, 2000, 1500), room);
    const auto lit_by = [&](std::uint64_t slot, std::vector<std::pair<Vector3f, float>> lamps) {
      lamps.push_back(bulb);
      return scene_->slot(slot, lamps);
    };
    const FrameSet even = lit_by(2, {{scene_->rig->projectors[0].lens.centre_mm().cast<float>(), 0.5F},
                                     {scene_->rig->projectors[1].lens.centre_mm().cast<float>(), 0.5F}});
    const FrameSet top = lit_by(5, {{lamp("top"), 1.0F}});
    const FrameSet low = lit_by(8, {{lamp("low"), 1.0F}});
    const std::array<LitSlot, 2> lit{{{&top, 0.3, {"top"}}, {&low, 0.6, {"low"}}}};
    EXPECT_EQ(refine(*stereo, even, lit), "") << room;
    EXPECT_GT(scene_->compare(added_).first, 0.8) << room;
  }
}

TEST_F(Photometric, ALightThatTheRigDoesNotHaveIsNamed) {
  const FrameSet even = blank();
  const std::array<LitSlot, 1> lit{{{&even, 0.5, {"ceiling"}}}};
  EXPECT_THAT(refine(*begun(), even, lit), testing::HasSubstr("'ceiling'"));
  EXPECT_THAT(added_, testing::Each(0.0F));
}

// A camera without a picture, or one that is white all over, says nothing; the other one still does.
TEST_F(Photometric, MissingAndSaturatedPicturesSayNothing) {
  FrameSet even = blank();
  FrameSet top = scene_->slot(5, {{lamp("top"), 1.0F}});
  FrameSet low = scene_->slot(8, {{lamp("low"), 1.0F}});
  top.frames[0] = {};
  const std::shared_ptr<std::uint8_t[]> white(new std::uint8_t[4 * kSide_px * kSide_px]);
  std::fill_n(white.get(), 4 * kSide_px * kSide_px, std::uint8_t{255});
  low.frames[0].pixels = white;
  const std::array<LitSlot, 2> lit{{{&top, 0.3, {"top"}}, {&low, 0.6, {"low"}}}};
  EXPECT_EQ(refine(*begun(), even, lit), "");
  EXPECT_GT(scene_->compare(added_).first, 0.7);
}

}  // namespace
}  // namespace facet::booth
