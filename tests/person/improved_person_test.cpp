#include "person/improved_person.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "facet/error.hpp"
#include "mesh/quads.hpp"
#include "person/surface_anchor.hpp"
#include "support/synthetic_model.hpp"

namespace facet::person {
namespace {

/// A head and what enrolments, wrong by as much as they say, see of it.
class ImprovedPersonTest : public ::testing::Test {
 protected:
  ImprovedPersonTest() : model_(test::synthetic_model(21)), skin_(free_skin(model_).skin) {
    truth_ =
        model_.contract_identity(std::vector<float>(static_cast<std::size_t>(model_.identity_count()), 0))
            .neutral_mm;
    mesh::vertex_normals(truth_, mesh::split_quads(model_.control.quads), normals_);
  }

  PersonFile enrolled(unsigned seed, float sigma_mm, float bump_mm = 0) const {
    PersonFile person;
    person.name = "Ada";
    person.model_name = model_.name;
    person.model_checksum = model_checksum(model_);
    person.identity.assign(static_cast<std::size_t>(model_.identity_count()), 0);
    person.keyframes = 14;
    person.span = {-10.0 - seed, 20, -5, 5.0 + seed};
    person.focal_px = 1000 + seed;
    person.neutral_mm = truth_;
    person.sigma_mm.assign(static_cast<std::size_t>(model_.vertex_count()), sigma_mm);
    std::mt19937 random(seed);
    std::normal_distribution<float> error(0, sigma_mm);
    for (const std::int32_t v : skin_) {
      const float bump = bump_mm * std::cos(0.05F * truth_(0, v));
      person.neutral_mm.col(v) += (error(random) + bump) * normals_.col(v);
    }
    return person;
  }

  double error_mm(const PersonFile& person) const {
    double sum = 0;
    for (const std::int32_t v : skin_) {
      const float d = normals_.col(v).dot(person.neutral_mm.col(v) - truth_.col(v));
      sum += static_cast<double>(d * d);
    }
    return std::sqrt(sum / static_cast<double>(skin_.size()));
  }

  face::FaceModel model_;
  std::vector<std::int32_t> skin_;
  mesh::Vertices truth_;
  Eigen::Matrix3Xf normals_;
};

TEST_F(ImprovedPersonTest, TwoEnrolmentsAreNearerThanEither) {
  const PersonFile first = enrolled(1, 0.4F);
  PersonFile second = enrolled(2, 0.3F);
  // The head's size and place are each solve's own.
  second.neutral_mm = (1.02F * second.neutral_mm).colwise() + Eigen::Vector3f(3, -2, 1);
  const ImprovedPerson both = improved(model_, first, second);
  ASSERT_TRUE(both.same_head) << both.disagreement;
  EXPECT_NEAR(both.disagreement, 0.67, 0.15) << "the median of a normal distribution";
  EXPECT_NEAR(error_mm(both.person), 0.24, 0.04);
  EXPECT_LT(error_mm(both.person), 0.9 * error_mm(second));
  const float sigma = both.person.sigma_mm[static_cast<std::size_t>(skin_[5])];
  EXPECT_GE(sigma, 0.3F) << "two that rest on one model may err alike";
  EXPECT_LT(sigma, 0.35F);
  EXPECT_NEAR(both.person.sigma_mm[static_cast<std::size_t>(skin_.back())], sigma, 1e-5F);
  EXPECT_EQ(both.person.keyframes, 28);
  EXPECT_EQ(both.person.span.least_yaw, -12);
  EXPECT_EQ(both.person.focal_px, 1002);
}

/// A relief of one texel that tells whose it is.
face::SkinChart relief_of(float mm) {
  face::SkinChart out;
  out.width = out.height = 1;
  out.texels_per_unit = 1;
  out.relief_mm = {mm};
  return out;
}

TEST_F(ImprovedPersonTest, ReliefsCountAsTheirShapesDo) {
  PersonFile first = enrolled(1, 0.4F);
  PersonFile second = enrolled(2, 0.2F);
  first.skin = relief_of(1);
  second.skin = relief_of(2);
  EXPECT_NEAR(improved(model_, first, second).person.skin.relief_mm.front(), 1.8F, 0.02F);
  EXPECT_NEAR(improved(model_, second, first).person.skin.relief_mm.front(), 1.8F, 0.02F);
  second.skin.texels_per_unit = 2;
  EXPECT_EQ(improved(model_, first, second).person.skin.relief_mm.front(), 2)
      << "another chart: the surer one's";
  second.skin = {};
  EXPECT_EQ(improved(model_, first, second).person.skin.relief_mm.front(), 1) << "the only one";
  EXPECT_EQ(improved(model_, second, first).person.skin.relief_mm.front(), 1);
}

/// Where one of them hardly knows, it hardly counts.
TEST_F(ImprovedPersonTest, ABadVideoSpoilsNothing) {
  const PersonFile first = enrolled(1, 0.2F);
  const ImprovedPerson both = improved(model_, first, enrolled(2, 1.5F));
  ASSERT_TRUE(both.same_head);
  EXPECT_LE(error_mm(both.person), 1.05 * error_mm(first));
}

/// What a solve says nothing of goes with the skin beside it: no step between the two.
TEST_F(ImprovedPersonTest, BesideTheSkinTheSameCounts) {
  const PersonFile first = enrolled(1, 0.2F);
  PersonFile second = enrolled(2, 1.5F);
  std::vector<char> is_skin(static_cast<std::size_t>(model_.vertex_count()), 0);
  for (const std::int32_t v : skin_) {
    is_skin[static_cast<std::size_t>(v)] = 1;
  }
  PersonFile known = first;
  int beside = 0;
  for (std::size_t v = 0; v < is_skin.size(); ++v) {
    if (is_skin[v] == 0) {
      known.sigma_mm[v] = second.sigma_mm[v] = std::numeric_limits<float>::quiet_NaN();
      second.neutral_mm(2, static_cast<Eigen::Index>(v)) += 10;
      ++beside;
    }
  }
  ASSERT_GT(beside, 0);
  const ImprovedPerson both = improved(model_, known, second);
  ASSERT_TRUE(both.same_head);
  EXPECT_LT((both.person.neutral_mm - known.neutral_mm).colwise().norm().maxCoeff(), 0.6F)
      << "2 % of 10 mm and of the noise";
  EXPECT_TRUE(both.person.neutral_mm.allFinite());
}

/// What one of them alone knows of is that one's; a certainty without bounds is none.
TEST_F(ImprovedPersonTest, WhatOneAloneKnowsIsTakenFromIt) {
  PersonFile first = enrolled(1, 0.3F);
  PersonFile second = enrolled(2, 0.3F);
  const auto a = static_cast<std::size_t>(skin_[3]);
  const auto b = static_cast<std::size_t>(skin_[4]);
  first.sigma_mm[a] = std::numeric_limits<float>::quiet_NaN();
  second.sigma_mm[b] = 0;
  const ImprovedPerson both = improved(model_, first, second);
  ASSERT_TRUE(both.same_head);
  EXPECT_NEAR((both.person.neutral_mm.col(skin_[3]) - second.neutral_mm.col(skin_[3])).norm(), 0, 0.05);
  EXPECT_NEAR((both.person.neutral_mm.col(skin_[4]) - first.neutral_mm.col(skin_[4])).norm(), 0, 1e-5);
  EXPECT_NEAR(both.person.sigma_mm[a], 0.3F, 1e-5F);
  EXPECT_NEAR(both.person.sigma_mm[b], 0.3F, 1e-5F);
}

TEST_F(ImprovedPersonTest, AnotherHeadChangesNothing) {
  const PersonFile first = enrolled(1, 0.3F);
  const ImprovedPerson both = improved(model_, first, enrolled(2, 0.3F, 4));
  EXPECT_FALSE(both.same_head);
  EXPECT_GT(both.disagreement, kSameHead);
  EXPECT_EQ(both.person.neutral_mm, first.neutral_mm);
  EXPECT_EQ(both.person.keyframes, 14);
}

/// Without their uncertainties nothing says whether two heads are one.
TEST_F(ImprovedPersonTest, WhoseUncertaintyIsNotKnownIsNotImproved) {
  PersonFile first = enrolled(1, 0.3F);
  first.sigma_mm.clear();
  EXPECT_FALSE(improved(model_, first, enrolled(2, 0.3F)).same_head);
}

TEST_F(ImprovedPersonTest, OfAnotherModelIsRefused) {
  PersonFile first = enrolled(1, 0.3F);
  first.model_checksum += 1;
  EXPECT_THROW(improved(model_, first, enrolled(2, 0.3F)), Error);
}

}  // namespace
}  // namespace facet::person
