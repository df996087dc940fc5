// What a recogniser is shown of a frame: the mesh's pictures lie where the photo's face is.

#include "footage/face_views.hpp"

#include <gtest/gtest.h>

#include <array>
#include <map>
#include <memory>
#include <string>

#include "report/take_pictures.hpp"
#include "support/mesh_frames.hpp"

namespace facet::footage {
namespace {

constexpr int kSide_px = 60;
using Rgb = std::array<std::uint8_t, 3>;

Rgb pixel(const render::Picture& picture, int x, int y) {
  const auto* at = &picture.rgb[3 * static_cast<std::size_t>(y * picture.width_px + x)];
  return {at[0], at[1], at[2]};
}

std::map<std::string, render::Picture> views_of(const mesh::MeshFrame& frame, const Frame& image) {
  std::map<std::string, render::Picture> views;
  for (const FaceView& view : face_views(frame, image, kSide_px)) {
    EXPECT_EQ(view.picture.width_px, kSide_px) << view.kind;
    EXPECT_EQ(view.picture.height_px, kSide_px) << view.kind;
    views[view.kind] = view.picture;
  }
  return views;
}

/// A frame of the patch in front of the camera without folds, with one albedo and one light.
mesh::MeshFrame plain_frame(const std::shared_ptr<const mesh::Subject>& subject, bool with_albedo) {
  mesh::MeshFrame frame = test::patch_frame(3, subject, nullptr);
  frame.displacements_mm.assign(frame.displacements_mm.size(), 0.0F);
  frame.lighting = {0.5F};
  if (with_albedo) {
    auto albedo = std::make_shared<mesh::Albedo>();
    albedo->version = 1;
    for (std::size_t v = 0; v < frame.displacements_mm.size(); ++v) {
      albedo->linear_rgb.insert(albedo->linear_rgb.end(), {0.6F, 0.4F, 0.2F});
    }
    frame.albedo = albedo;
  }
  return frame;
}

TEST(FaceViews, AreOneSquareRoundTheMesh) {
  const Frame image = render::to_frame(render::plain_picture(1280, 720, {10, 200, 90}));
  const auto views = views_of(plain_frame(test::patch_subject(), true), image);
  ASSERT_EQ(views.size(), 5U);
  const Rgb photo{10, 200, 90};
  // The mesh fills the middle and leaves a margin.
  EXPECT_EQ(pixel(views.at("photo"), 0, 0), photo);
  EXPECT_EQ(pixel(views.at("cut"), kSide_px / 2, kSide_px / 2), photo);
  for (const char* kind : {"cut", "grey", "albedo", "lit"}) {
    EXPECT_EQ(pixel(views.at(kind), 0, 0), report::kPaper) << kind;
    EXPECT_NE(pixel(views.at(kind), kSide_px / 2, kSide_px / 2), report::kPaper) << kind;
  }
  const auto sides = pixel(views.at("grey"), kSide_px / 2, kSide_px / 2);
  EXPECT_EQ(sides[0], sides[1]);
  EXPECT_EQ(sides[1], sides[2]);
}

TEST(FaceViews, AlbedoIsPlainAndLitUnderTheLight) {
  const Frame image = render::to_frame(render::plain_picture(1280, 720, {10, 200, 90}));
  const auto views = views_of(plain_frame(test::patch_subject(), true), image);
  const Rgb albedo = pixel(views.at("albedo"), kSide_px / 2, kSide_px / 2);
  const Rgb lit = pixel(views.at("lit"), kSide_px / 2, kSide_px / 2);
  for (std::size_t channel = 0; channel < 3; ++channel) {
    const float reflected = std::array{0.6F, 0.4F, 0.2F}[channel];
    EXPECT_NEAR(albedo[channel], render::linear_to_srgb8(reflected), 1);
    EXPECT_NEAR(lit[channel], render::linear_to_srgb8(0.5F * reflected), 1);
  }
}

TEST(FaceViews, FoldsAreInTheGreyMeshAlone) {
  const auto subject = test::patch_subject();
  const Frame image = render::to_frame(render::plain_picture(1280, 720, {10, 200, 90}));
  const mesh::MeshFrame plain = plain_frame(subject, true);
  mesh::MeshFrame folded = plain;
  folded.displacements_mm = test::patch_frame(3, subject, nullptr).displacements_mm;
  const auto without = views_of(plain, image);
  const auto with = views_of(folded, image);
  EXPECT_EQ(without.at("photo").rgb, with.at("photo").rgb);
  EXPECT_NE(without.at("grey").rgb, with.at("grey").rgb);
}

TEST(FaceViews, WithoutAlbedoThereAreNoPicturesOfIt) {
  const Frame image = render::to_frame(render::plain_picture(1280, 720, {10, 200, 90}));
  const auto views = views_of(plain_frame(test::patch_subject(), false), image);
  EXPECT_EQ(views.size(), 3U);
  EXPECT_EQ(views.count("albedo"), 0U);
}

}  // namespace
}  // namespace facet::footage
