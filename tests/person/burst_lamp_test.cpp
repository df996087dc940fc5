#include "person/burst_lamp.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>
#include <vector>

#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "mesh/quads.hpp"
#include "person/texture_chart.hpp"

namespace facet::person {
namespace {

constexpr float kDegree = 0.01745329F;

/// The mean face of the model 600 mm before a camera, in a room whose light comes from the left.
class BurstLampTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(default_model_file())) {
      GTEST_SKIP() << "no " << default_model_file() << ": facet model build makes it";
    }
    const face::FaceModel model = face::FaceModel::load(default_model_file());
    triangles_ = mesh::split_quads(model.control.quads);
    surface_mm_ = model.core_row(0, 0);
    mesh::vertex_normals(surface_mm_, triangles_, normals_);
    texels_.emplace(face_chart(model, 256), triangles_, surface_mm_);
    visibility_ = {surface_mm_, normals_, triangles_};
    // The head's axes have y up and z to the front.
    pose_.linear() = Eigen::Vector3f(1, -1, -1).asDiagonal();
    pose_.translation() = Eigen::Vector3f(0, 0, 600) - pose_.linear() * surface_mm_.rowwise().mean();
    albedo_.resize(texels_->count());
    dark_.resize(texels_->count());
    for (Eigen::Index i = 0; i < albedo_.size(); ++i) {
      albedo_[i] = 0.3F + 0.05F * std::sin(static_cast<float>(i % 97));
      dark_[i] = albedo_[i] * (0.6F + 0.3F * texels_->normals(0, i));
    }
  }

  LitSurface surface() const { return {*texels_, surface_mm_, normals_, triangles_}; }

  /// A point light at a place of the camera's frame, by a formula of this test's own: no shadows but those of
  /// the skin that is turned away.
  float from_lamp(Eigen::Index texel, const Eigen::Vector3f& place_mm) const {
    const Eigen::Vector3f middle_mm(0, 0, 600);
    const Eigen::Vector3f at_mm = middle_mm + pose_.linear() * texels_->positions_mm.col(texel);
    const Eigen::Vector3f away = place_mm - at_mm;
    const float cosine = away.normalized().dot(pose_.linear() * texels_->normals.col(texel));
    return std::max(cosine, 0.0F) * (place_mm - middle_mm).squaredNorm() / away.squaredNorm();
  }

  /// exposure  of the lit picture against the dark one
  LitPicture picture(const Eigen::Vector3f& place_mm, float strength, float exposure) const {
    LitPicture out;
    out.camera_from_head = pose_;
    out.weight = Eigen::ArrayXf::Ones(texels_->count());
    out.brightness.resize(texels_->count());
    for (Eigen::Index i = 0; i < out.brightness.size(); ++i) {
      out.brightness[i] = exposure * (dark_[i] + strength * albedo_[i] * from_lamp(i, place_mm));
      // What is turned away from the camera is not seen.
      out.weight[i] = texels_->normals(2, i) > 0.3F ? 1.0F : 0.0F;
    }
    return out;
  }

  mesh::Triangles triangles_;
  mesh::Vertices surface_mm_;
  Eigen::Matrix3Xf normals_;
  std::optional<SkinTexels> texels_;
  light::HeadVisibility visibility_;
  Eigen::Isometry3f pose_ = Eigen::Isometry3f::Identity();
  Eigen::ArrayXf albedo_, dark_;
};

TEST_F(BurstLampTest, IsFoundWhereItIs) {
  const Eigen::Vector3f middle_mm(0, 0, 600);
  for (const Eigen::Vector3f& place_mm :
       {Eigen::Vector3f(250, -60, 150), Eigen::Vector3f(-40, -300, 120), Eigen::Vector3f(-600, 200, -200),
        Eigen::Vector3f(1100, -900, -800)}) {
    const std::vector<LitPicture> pictures{picture(place_mm, 0.5F, 1), picture(place_mm, 0.5F, 0.9F)};
    const auto lamp = find_burst_lamp(surface(), visibility_, pictures, dark_, albedo_, 0.25F);
    ASSERT_TRUE(lamp) << place_mm.transpose();
    const Eigen::Vector3f there = place_mm - middle_mm;
    const Eigen::Vector3f found = lamp->place_mm - middle_mm;
    const float off_deg = std::acos(found.normalized().dot(there.normalized())) / kDegree;
    EXPECT_LT(off_deg, 3) << found.transpose() << " for " << there.transpose();
    EXPECT_NEAR(std::log(found.norm() / there.norm()), 0, 0.15);
    EXPECT_NEAR(lamp->exposure[0], 1, 0.02);
    EXPECT_NEAR(lamp->exposure[1], 0.9, 0.02);
    EXPECT_NEAR(lamp->strength[0], 0.5, 0.04);
    EXPECT_LT(lamp->unexplained, 0.08);
  }
}

TEST_F(BurstLampTest, WhereNoneFiresNoneIsFound) {
  LitPicture picture = this->picture({250, -60, 150}, 0.5F, 1);
  picture.brightness = dark_;
  EXPECT_FALSE(find_burst_lamp(surface(), visibility_, std::vector{picture}, dark_, albedo_, 0.25F));
  picture.weight.setZero();
  EXPECT_FALSE(find_burst_lamp(surface(), visibility_, std::vector{picture}, dark_, albedo_, 0.25F));
}

/// A quarter of the face lit, with a straight edge, is no small lamp's: more is left over than of one.
TEST_F(BurstLampTest, WhatIsNoLampIsTold) {
  LitPicture picture = this->picture({250, -60, 150}, 0.5F, 1);
  for (Eigen::Index i = 0; i < albedo_.size(); ++i) {
    picture.brightness[i] = dark_[i] + 0.2F * albedo_[i] * (texels_->positions_mm(0, i) > 0 ? 1.0F : 0.05F) *
                                           (texels_->positions_mm(1, i) > 0 ? 0.05F : 1.0F);
  }
  const auto lamp = find_burst_lamp(surface(), visibility_, std::vector{picture}, dark_, albedo_, 0.25F);
  EXPECT_TRUE(!lamp || lamp->unexplained > 0.3F) << lamp->unexplained;
}

TEST_F(BurstLampTest, SlopesAreTheShadingsChange) {
  const BurstLamp lamp{{200, -150, 100}, 500, {}, {}, 0};
  const LampShading given = lamp_shading(surface(), lamp, pose_);
  constexpr float kRise_mm = 0.002F;  // from texel to texel
  for (const bool u : {true, false}) {
    SkinTexels raised = *texels_;
    for (Eigen::Index i = 0; i < raised.count(); ++i) {
      raised.normals.col(i) -= kRise_mm * (u ? raised.along_u : raised.along_v).col(i);
    }
    const LampShading other = lamp_shading({raised, surface_mm_, normals_, triangles_}, lamp, pose_);
    const Eigen::ArrayXf change = (other.shading - given.shading) / kRise_mm;
    const Eigen::ArrayXf& told = u ? given.slope_u : given.slope_v;
    EXPECT_GT(told.abs().maxCoeff(), 0.1F);
    EXPECT_LT((change - told).abs().mean(), 0.02F * told.abs().mean());
  }
}

/// The nose's shadow: a lamp that is nearer throws a wider one. Skin that mirrors the lamp is not trusted.
TEST_F(BurstLampTest, ShadowsAndMirrorsAreTold) {
  const auto shaded = [&](float far_mm) {
    const Eigen::Vector3f towards = Eigen::Vector3f(0.8F, 0, -0.6F);
    const Eigen::ArrayXf seen = light::seen_from_lamp(
        surface_mm_, normals_, triangles_,
        pose_.inverse() * Eigen::Vector3f(Eigen::Vector3f(0, 0, 600) + far_mm * towards));
    return (1 - seen).sum();
  };
  EXPECT_GT(shaded(300), 1.02F * shaded(3000));
  EXPECT_GT(shaded(3000), 10) << "a head hides parts of itself";
  // A lamp beside the camera: what faces both mirrors it, what is turned to a side does not.
  const LampShading given = lamp_shading(surface(), BurstLamp{{20, 0, 0}, 600, {}, {}, 0}, pose_);
  int mirrors = 0;
  int matt = 0;
  for (Eigen::Index i = 0; i < texels_->count(); ++i) {
    const Eigen::Vector3f to_eye(0, 0, 600);
    const float facing = texels_->normals.col(i).dot((to_eye - texels_->positions_mm.col(i)).normalized());
    if (facing > std::cos(3 * kDegree)) {
      EXPECT_EQ(given.trust[i], 0);
      ++mirrors;
    }
    if (facing < std::cos(20 * kDegree) && facing > std::cos(40 * kDegree) && given.trust[i] == 1) {
      ++matt;
    }
  }
  EXPECT_GT(mirrors, 20);
  EXPECT_GT(matt, 1000);
}

}  // namespace
}  // namespace facet::person
