#include "simulation/look.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "facet/error.hpp"
#include "simulation/actor.hpp"
#include "simulation/chromophores.hpp"
#include "simulation/skin_maps.hpp"
#include "support/synthetic_model.hpp"

namespace facet::simulation {
namespace {

Look look_of(int skin_type) {
  Look look;
  look.skin_type = skin_type;
  return look;
}

const face::FaceModel& model() {
  static const face::FaceModel made = test::synthetic_model();
  return made;
}

/// Over the skin that nothing covers.
Eigen::Vector3f mean_skin(const VirtualActor& actor, const Eigen::Matrix3Xf& albedo) {
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  float weight = 0;
  for (Eigen::Index v = 0; v < albedo.cols(); ++v) {
    const float bare = actor.face_skin()[v] * (1 - actor.skin_maps().cover[v]);
    sum += bare * albedo.col(v);
    weight += bare;
  }
  return sum / weight;
}

TEST(Look, LeavesOutWhatIsNamed) {
  const Look look = without(look_of(3), "strands,bounce");
  EXPECT_FALSE(look.strands);
  EXPECT_FALSE(look.bounce);
  EXPECT_TRUE(look.scattering);
  EXPECT_EQ(effects_of(look).size() + 2, look_effects().size());
  EXPECT_THROW(without(look, "strand"), Error);
  EXPECT_EQ(parse_skin_type("6"), 6);
  EXPECT_EQ(parse_skin_type(skin_type_name(Look::kAnyType)), Look::kAnyType);
  EXPECT_EQ(parse_skin_type(skin_type_name(Look::kPainted)), Look::kPainted);
  for (const char* wrong : {"", "0", "7", "dark", "11"}) {
    EXPECT_THROW(parse_skin_type(wrong), Error) << wrong;
  }
}

TEST(SkinOptics, MelaninDarkensAndBloodReddens) {
  const SkinOptics& optics = skin_optics();
  for (const float blood : {0.002F, 0.01F, 0.05F}) {
    float before = 1;
    for (const float melanin : {0.005F, 0.02F, 0.05F, 0.12F, 0.3F}) {
      const Eigen::Vector3f colour = optics.albedo({melanin, blood});
      EXPECT_GT(colour.x(), colour.y());  // skin is never green or blue
      EXPECT_GT(colour.y(), colour.z() * 0.95F);
      EXPECT_LT(colour.y(), before);
      before = colour.y();
      const Eigen::Vector3f flushed = optics.albedo({melanin, 2 * blood});
      EXPECT_LT(flushed.y(), colour.y());
      if (melanin < 0.1F && blood < 0.03F) {  // below more melanin blood does not show
        EXPECT_GT(flushed.x() / flushed.y(), colour.x() / colour.y());
      }
    }
  }
  // Beyond the table: the last value, not a step outside.
  EXPECT_EQ(optics.albedo({9, 9}), optics.albedo({SkinOptics::kMaxMelanin, SkinOptics::kMaxBlood}));
}

TEST(SkinOptics, TheTypologyAngleIsThatOfCielab) {
  // L* 66.3, b* 16.6 by the CIE's formulas.
  EXPECT_NEAR(typology_deg({0.46F, 0.34F, 0.23F}), 44.5F, 0.3F);
  const float melanin = skin_optics().melanin_of(20, 0.01F);
  EXPECT_NEAR(typology_deg(skin_optics().albedo({melanin, 0.01F})), 20, 0.1F);
}

TEST(Person, HasTheToneOfItsType) {
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    float lighter = 1;
    for (int type = 1; type <= 6; ++type) {
      const Person person = make_person(look_of(type), seed);
      const TypologyRange range = typology_of_type(type);
      EXPECT_NEAR(typology_deg(person.complexion.skin), range.middle_deg, range.half_width_deg);
      EXPECT_LT(person.complexion.skin.y(), lighter) << "type " << type << ", seed " << seed;
      lighter = person.complexion.skin.y();
      if (type >= 4) {
        EXPECT_LT(person.complexion.iris.maxCoeff(), 0.1F);
      }
    }
  }
  // Published: the palest skins reflect about six tenths of red light, the darkest about an eighth.
  EXPECT_NEAR(make_person(look_of(1), 1).complexion.skin.x(), 0.57F, 0.08F);
  EXPECT_NEAR(make_person(look_of(6), 1).complexion.skin.x(), 0.15F, 0.06F);
}

TEST(VirtualActorLook, SkinHasItsTypeWithRedderCheeksAndLips) {
  for (const int type : {1, 6}) {
    const VirtualActor actor(model(), {.seed = 3, .look = look_of(type)});
    const Eigen::Matrix3Xf& albedo = actor.head_albedo();
    EXPECT_TRUE(albedo.allFinite());
    EXPECT_GT(albedo.minCoeff(), 0);
    EXPECT_LT(albedo.maxCoeff(), 1);
    const TypologyRange range = typology_of_type(type);
    EXPECT_NEAR(typology_deg(mean_skin(actor, albedo)), range.middle_deg, range.half_width_deg + 12);
    const Anatomy& face = actor.anatomy();
    const auto blood_near = [&](const Eigen::Vector3f& place) {
      float sum = 0;
      float weight = 0;
      for (Eigen::Index v = 0; v < albedo.cols(); ++v) {
        const float near = std::exp(-(actor.resting_mm().col(v) - place).squaredNorm() / 50);
        sum += near * actor.skin_maps().blood[v];
        weight += near;
      }
      return sum / weight;
    };
    const float forehead = blood_near(0.5F * (face.forehead + face.nasion));
    EXPECT_GT(blood_near(face.nose_tip), 1.4F * forehead);
    EXPECT_GT(blood_near(0.5F * (face.lip_upper + face.lip_lower)), 1.5F * forehead);
  }
}

TEST(VirtualActorLook, BloodMovesWithTheExpressionAndOnlyWithIt) {
  Look look = look_of(2);
  const VirtualActor actor(model(), {.seed = 3, .look = look});
  std::vector<float> expression(actor.expression_names().size(), 0);
  ActorShape rest;
  actor.shape(expression, {}, rest);
  EXPECT_LT((rest.albedo - actor.head_albedo()).cwiseAbs().maxCoeff(), 1e-4F);
  std::fill(expression.begin(), expression.end(), 0.6F);
  ActorShape moved;
  actor.shape(expression, {}, moved);
  const float change = (moved.albedo - rest.albedo).cwiseAbs().maxCoeff();
  EXPECT_GT(change, 0.01F);
  EXPECT_LT(change, 0.25F);
  look.blood = false;
  const VirtualActor still(model(), {.seed = 3, .look = look});
  still.shape(expression, {}, moved);
  EXPECT_EQ(moved.albedo, still.head_albedo());
}

TEST(VirtualActorLook, AnyTypeFollowsFromTheSeed) {
  std::vector<float> tones;
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    tones.push_back(make_person(look_of(Look::kAnyType), seed).complexion.skin.y());
    EXPECT_EQ(tones.back(), make_person(look_of(Look::kAnyType), seed).complexion.skin.y());
  }
  EXPECT_LT(*std::min_element(tones.begin(), tones.end()), 0.12F);
  EXPECT_GT(*std::max_element(tones.begin(), tones.end()), 0.35F);
}

}  // namespace
}  // namespace facet::simulation
