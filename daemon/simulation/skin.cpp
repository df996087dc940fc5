#include "simulation/skin.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace facet::simulation {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

Vector3f mixed(const Vector3f& from, const Vector3f& to, float part) {
  return from + part * (to - from);
}

}  // namespace

float brow_cover(const Anatomy& face, std::size_t index, const Eigen::Vector3f& at, const Noise& strands) {
  const float side = Anatomy::side(index);
  const Vector3f& brow = face.brow[index];
  const float inner_x = face.eye_inner[index].x() - side * 1.0F;
  const float outer_x = face.eye_outer[index].x() + side * 5.0F;
  const float along = (at.x() - inner_x) / (outer_x - inner_x);
  if (along < -0.1F || along > 1.1F || std::abs(at.y() - brow.y()) > 16) {
    return 0;
  }
  // The brow landmark lies on the upper edge, a bit outside of the middle; the ends hang lower.
  const float centre_y = brow.y() - 1.6F - 5.5F * (along - 0.55F) * (along - 0.55F) / 0.3F;
  const float half_height = 3.6F - 1.9F * std::clamp(along, 0.0F, 1.0F);
  const float across = (at.y() - centre_y) / half_height;
  const float band = smooth_step(1.35F, 0.55F, std::abs(across)) * smooth_step(-0.06F, 0.12F, along) *
                     smooth_step(1.06F, 0.75F, along);
  const float slant = 0.9F - 1.1F * along;  // upright near the nose, lying outwards
  const float strand = strands.at({(at.x() - side * slant * at.y()) / 0.9F, at.y() / 5.0F, at.z() / 5.0F});
  return band * std::clamp(0.85F + 0.4F * strand, 0.0F, 1.0F);
}

float beard_zone(const Anatomy& face, const Eigen::Vector3f& at) {
  const float nose_base_y = face.nose_tip.y() - 11;
  const float out = std::abs(at.x() - face.nose_tip.x());
  // The upper border runs from under the nose down round the mouth's corners and up again to the ears.
  const float border_y =
      nose_base_y - 14 * std::exp(-(out - 36) * (out - 36) / 300) + 0.55F * std::max(0.0F, out - 42);
  return smooth_step(border_y + 3, border_y - 6, at.y());
}

Complexion make_complexion(std::uint64_t seed) {
  Random random(seed, 41);
  Complexion complexion;
  const float depth = random.uniform();
  // Linear albedo of light, tan and dark skin.
  complexion.skin = depth < 0.5F ? mixed({0.56F, 0.34F, 0.255F}, {0.44F, 0.25F, 0.165F}, 2 * depth)
                                 : mixed({0.44F, 0.25F, 0.165F}, {0.17F, 0.09F, 0.058F}, 2 * depth - 1);
  const float fair = depth < 0.45F ? random.uniform() : 0.0F;
  complexion.hair = mixed({0.012F, 0.009F, 0.008F}, {0.16F, 0.095F, 0.045F}, fair * fair);
  const Vector3f brown(0.11F, 0.05F, 0.02F);
  const Vector3f blue(0.16F, 0.24F, 0.33F);
  complexion.iris = fair > 0.4F ? mixed(brown, blue, random.uniform(0.5F, 1.0F)) : brown;
  complexion.beard = random.uniform() < 0.5F ? random.uniform(0.25F, 0.7F) : 0.0F;
  return complexion;
}

float above_hairline_mm(const Anatomy& anatomy, const Eigen::Vector3f& point_mm, float skin) {
  constexpr float kAboveLandmark_mm = 5;
  constexpr float kOnSkin_mm = -12;
  const Vector3f front = anatomy.forehead + Vector3f(0, kAboveLandmark_mm, 0);
  const float temple_y = 0.5F * (anatomy.eye_outer[0].y() + anatomy.eye_outer[1].y()) + 16;
  const float temple_z = front.z() - 72;
  // Side view: a line from the forehead back and down to above the ear, then straight down behind it.
  const Vector2f line = Vector2f(temple_z - front.z(), temple_y - front.y()).normalized();
  const Vector2f upwards(line.y(), -line.x());
  const float over = (Vector2f(point_mm.z(), point_mm.y()) - Vector2f(front.z(), front.y())).dot(upwards);
  const float behind = temple_z - 48 - point_mm.z();
  const float nape_y = 0.5F * (anatomy.nose_tip.y() + anatomy.mouth_corner[0].y());
  // Ears stick out farther than the skull is wide.
  const float skull_mm = 1.72F * anatomy.eye_outer[1].x();
  const float above =
      std::min({std::max(over, behind), point_mm.y() - nape_y, 3 * (skull_mm - std::abs(point_mm.x()))});
  return above + (kOnSkin_mm - std::max(above, 0.0F)) * smooth_step(0.02F, 0.5F, skin);
}

Eigen::Matrix3Xf paint_albedo(const Anatomy& anatomy, const Complexion& complexion, const SkinZones& zones,
                              const Eigen::Matrix3Xf& resting_mm, const Eigen::Matrix3Xf& mean_albedo,
                              std::uint64_t seed) {
  Random random(seed, 42);
  const Noise blotches(seed, 43);
  const Noise mottle(seed, 44);
  const Noise fine(seed, 45);
  const Noise strands(seed, 46);
  const Noise stubble(seed, 47);
  const Noise edge(seed, 48);

  Vector3f mean_tone = Vector3f::Zero();
  for (Eigen::Index v = 0; v < resting_mm.cols(); ++v) {
    mean_tone += zones.skin[v] * mean_albedo.col(v);
  }
  mean_tone /= std::max(1.0F, zones.skin.sum());

  struct Spot {
    Vector3f at_mm;
    float radius_mm;
    float depth;
  };
  std::vector<Spot> spots;  // freckles and moles, picked among the skin's vertices
  const int spot_count = 12 + random.below(50);
  for (int k = 0; k < spot_count; ++k) {
    const Eigen::Index v = random.below(static_cast<int>(resting_mm.cols()));
    if (zones.skin[v] > 0.9F) {
      const bool mole = random.uniform() < 0.12F;
      spots.push_back({resting_mm.col(v), mole ? random.uniform(0.9F, 1.6F) : random.uniform(0.5F, 0.9F),
                       mole ? random.uniform(0.4F, 0.7F) : random.uniform(0.12F, 0.3F)});
    }
  }

  const float eye_y = 0.5F * (anatomy.eye_outer[0].y() + anatomy.eye_outer[1].y());
  Eigen::Matrix3Xf albedo(3, resting_mm.cols());
  for (Eigen::Index v = 0; v < resting_mm.cols(); ++v) {
    const Vector3f at = resting_mm.col(v);
    const Vector3f pattern = (mean_albedo.col(v).array() / mean_tone.array()).max(0.35F).min(1.6F);
    Vector3f colour = complexion.skin.array() * pattern.array().pow(0.6F);

    // Blood: cheeks and nose are redder; more where the skin is light.
    float red = 0;
    for (const std::size_t side : {std::size_t{0}, std::size_t{1}}) {
      const Vector3f cheek(anatomy.eye_outer[side].x() * 0.85F, anatomy.nose_tip.y() - 1,
                           anatomy.nose_tip.z() - 28);
      red += std::exp(-(at - cheek).squaredNorm() / (19 * 19));
    }
    red += 0.8F * std::exp(-(at - anatomy.nose_tip).squaredNorm() / (12 * 12));
    red = (0.16F * red + 0.05F * mottle.fractal(at / 17.0F, 2)) * zones.skin[v];
    colour = colour.array() * Vector3f(1 + 0.35F * red, 1 - 0.75F * red, 1 - 0.7F * red).array();
    colour *= 1 + 0.085F * blotches.fractal(at / 26.0F, 3) + 0.06F * fine.fractal(at / 3.4F, 2);
    for (const Spot& spot : spots) {
      const float distance = (at - spot.at_mm).norm() / spot.radius_mm;
      if (distance < 2) {
        colour *= 1 - spot.depth * smooth_step(1.3F, 0.6F, distance);
      }
    }
    if (complexion.beard > 0) {
      const float cover = complexion.beard * beard_zone(anatomy, at) * zones.skin[v] * (1 - zones.lips[v]);
      const float hairs = 0.35F + 0.5F * smooth_step(-0.1F, 0.7F, stubble.at(at / 1.25F));
      colour = mixed(colour, 0.35F * colour + 0.5F * complexion.hair, cover * hairs);
    }
    const Vector3f lip = complexion.skin.array() * Vector3f(0.84F, 0.57F, 0.6F).array();
    colour = mixed(colour, lip * (1 + 0.1F * fine.at({at.x() / 1.6F, at.y() / 7.0F, at.z() / 7.0F})),
                   0.85F * smooth_step(0.25F, 0.75F, zones.lips[v]));

    for (const std::size_t side : {std::size_t{0}, std::size_t{1}}) {
      colour = mixed(colour, 0.9F * complexion.hair + 0.06F * complexion.skin,
                     0.92F * brow_cover(anatomy, side, at, strands));
    }
    // Lashes and the lids' margins: dark above, reddish below.
    const float margin = smooth_step(0.08F, 0.3F, zones.eye[v]) * smooth_step(1.0F, 0.6F, zones.eye[v]);
    const bool upper = at.y() > eye_y - 1.5F;
    colour = mixed(colour, upper ? Vector3f(0.5F * complexion.hair) : Vector3f(0.55F * colour),
                   margin * (upper ? 0.9F : 0.6F));
    colour = mixed(colour, complexion.skin.cwiseProduct(Vector3f(0.75F, 0.5F, 0.5F)),
                   smooth_step(0.6F, 0.95F, zones.eye[v]));
    colour = mixed(colour, {0.13F, 0.03F, 0.03F}, smooth_step(0.3F, 0.8F, zones.mouth[v]));

    const float hairline = above_hairline_mm(anatomy, at, zones.skin[v]) + 2.5F * edge.fractal(at / 9.0F, 2);
    const float strand = strands.fractal({at.x() / 1.3F, at.y() / 14.0F, at.z() / 9.0F}, 2);
    colour = mixed(colour, complexion.hair * std::max(0.25F, 1 + 0.55F * strand),
                   smooth_step(-2.0F, 4.0F, hairline));

    // Nostrils and sockets get no light that the shading model knows of.
    const float hollow = std::max(
        {zones.eye[v], zones.mouth[v], std::exp(-(at - anatomy.nose_tip).squaredNorm() / (22 * 22))});
    colour *= 1 - 0.94F * smooth_step(0.1F, 0.4F, hollow) * smooth_step(0.42F, 0.06F, zones.openness[v]);
    albedo.col(v) = colour.cwiseMax(0.004F).cwiseMin(0.9F);
  }
  return albedo;
}

}  // namespace facet::simulation
