#include "simulation/skin_maps.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "render/renderer.hpp"
#include "simulation/random.hpp"

namespace facet::simulation {
namespace {

using Eigen::Vector3f;

constexpr float kBlood = 0.011F;  // of a dermis where nothing is special

Vector3f mixed(const Vector3f& from, const Vector3f& to, float part) {
  return from + part * (to - from);
}

/// Hair by type: fair and red ones only on light skins, grey on all.
Vector3f hair_colour(int type, Random& random) {
  const Vector3f black(0.010F, 0.008F, 0.007F);
  const Vector3f dark(0.022F, 0.013F, 0.009F);
  const Vector3f brown(0.060F, 0.034F, 0.020F);
  const Vector3f fair(0.230F, 0.145F, 0.070F);
  const Vector3f red(0.150F, 0.048F, 0.020F);
  const Vector3f grey(0.240F, 0.230F, 0.220F);
  const float pick = random.uniform();
  const float shade = random.uniform();
  Vector3f colour = mixed(black, dark, shade);
  if (type <= 2) {
    colour = pick < 0.15F  ? mixed(red, fair, 0.4F * shade)
             : pick < 0.5F ? mixed(brown, fair, shade)
                           : mixed(dark, brown, shade);
  } else if (type == 3) {
    colour = pick < 0.5F ? mixed(dark, brown, shade) : mixed(black, dark, shade);
  }
  return random.uniform() < 0.12F ? mixed(colour, grey, random.uniform(0.4F, 0.9F)) : colour;
}

Vector3f iris_colour(int type, Random& random) {
  const Vector3f brown(0.085F, 0.040F, 0.018F);
  const Vector3f dark(0.035F, 0.018F, 0.010F);
  const Vector3f hazel(0.130F, 0.100F, 0.040F);
  const Vector3f blue(0.140F, 0.210F, 0.290F);
  const float pick = random.uniform();
  const float shade = random.uniform();
  if (type <= 2) {
    return pick < 0.55F ? mixed(hazel, blue, shade) : mixed(brown, hazel, shade);
  }
  return type == 3 && pick < 0.3F ? mixed(brown, hazel, shade) : mixed(dark, brown, shade);
}

/// Where [JSB10] found more blood than on the forehead, as a factor.
float blood_of_place(const Anatomy& face, const Vector3f& at) {
  float factor = 1;
  for (std::size_t side = 0; side < 2; ++side) {
    const Vector3f cheek(face.eye_outer[side].x() * 0.85F, face.nose_tip.y() - 1, face.nose_tip.z() - 28);
    factor += 0.55F * std::exp(-(at - cheek).squaredNorm() / (20 * 20));
    const float beyond = Anatomy::side(side) * (at.x() - 1.45F * face.eye_outer[side].x());
    factor += 0.9F * smooth_step(0, 12, beyond);  // ears
    const Vector3f below_eye = 0.5F * (face.eye_outer[side] + face.eye_inner[side]) + Vector3f(0, -11, 2);
    factor += 0.5F * std::exp(-(at - below_eye).squaredNorm() / (9 * 9));
  }
  factor += 1.1F * std::exp(-(at - face.nose_tip).squaredNorm() / (13 * 13));
  factor += 0.35F * std::exp(-(at - face.chin).squaredNorm() / (16 * 16));
  return factor;
}

/// Where melanin gathers: round the eyes, on lids and temples; palest on the cheeks.
float melanin_of_place(const Anatomy& face, const Vector3f& at) {
  float factor = 1;
  for (std::size_t side = 0; side < 2; ++side) {
    const Vector3f eye = 0.5F * (face.eye_outer[side] + face.eye_inner[side]);
    const Vector3f away = (at - eye).cwiseQuotient(Vector3f(19, 13, 22));
    factor += 0.22F * std::exp(-away.squaredNorm());
  }
  factor += 0.07F * smooth_step(0, 25, at.y() - face.brow[0].y());
  return factor;
}

struct Spot {
  Vector3f at_mm;
  float radius_mm;
  float melanin;
};

std::vector<Spot> make_moles(const SkinZones& zones, const Eigen::Matrix3Xf& resting_mm, float freckles,
                             Random& random) {
  std::vector<Spot> spots;
  const int count = 4 + random.below(10 + static_cast<int>(14 * freckles));
  for (int k = 0; k < count; ++k) {
    const Eigen::Index v = random.below(static_cast<int>(resting_mm.cols()));
    const float radius_mm = random.uniform(0.5F, 1.5F);
    const float melanin = random.uniform(0.03F, 0.13F);
    if (zones.skin[v] > 0.9F && zones.lips[v] < 0.1F) {
      spots.push_back({resting_mm.col(v), radius_mm, melanin});
    }
  }
  return spots;
}

/// What lies over the skin, thickest last.
class Cover {
 public:
  void add(const Vector3f& colour, float part) {
    const float whole = part + part_ * (1 - part);
    if (whole > 0) {
      colour_ = (part * colour + part_ * (1 - part) * colour_) / whole;
      part_ = whole;
    }
  }
  float part() const { return part_; }
  const Vector3f& colour() const { return colour_; }

 private:
  float part_ = 0;
  Vector3f colour_{0, 0, 0};
};

/// Painted hair where the look has no strands.
void paint_hairs(const Anatomy& face, const Person& person, const Vector3f& at, const SkinZones& zones,
                 Eigen::Index v, const Noise& noise, Cover& cover) {
  const Complexion& complexion = person.complexion;
  for (std::size_t side = 0; side < 2; ++side) {
    cover.add(complexion.hair, 0.9F * brow_cover(face, side, at, noise));
  }
  if (person.beard_mm > 0) {
    const float hairs = 0.35F + 0.5F * smooth_step(-0.1F, 0.7F, noise.at(at / 1.25F));
    cover.add(complexion.hair, 0.6F * hairs * beard_zone(face, at) * zones.skin[v] * (1 - zones.lips[v]));
  }
  const float margin = smooth_step(0.08F, 0.3F, zones.eye[v]) * smooth_step(1.0F, 0.6F, zones.eye[v]);
  const float eye_y = 0.5F * (face.eye_outer[0].y() + face.eye_outer[1].y());
  if (at.y() > eye_y - 1.5F) {
    cover.add(0.5F * complexion.hair, 0.9F * margin);
  }
}

struct Paint {
  Vector3f lips, cheeks, lids;
  float lip_part, cheek_part, lid_part;
};

Paint make_paint(const Person& person, std::uint64_t seed) {
  Random random(seed, 54);
  const Vector3f red = mixed({0.42F, 0.035F, 0.05F}, {0.40F, 0.12F, 0.11F}, random.uniform());
  const float deep = std::clamp(person.complexion.skin.y() / 0.25F, 0.45F, 1.0F);
  return {deep * red,
          deep * Vector3f(0.55F, 0.20F, 0.19F),
          mixed({0.10F, 0.06F, 0.05F}, {0.16F, 0.12F, 0.16F}, random.uniform()),
          random.uniform(0.4F, 0.85F),
          random.uniform(0.1F, 0.35F),
          random.uniform(0.1F, 0.5F)};
}

void put_makeup(const Anatomy& face, const Paint& paint, const Vector3f& at, float lips, Cover& cover) {
  for (std::size_t side = 0; side < 2; ++side) {
    const Vector3f cheek(face.eye_outer[side].x() * 0.95F, face.nose_tip.y() + 6, face.nose_tip.z() - 30);
    cover.add(paint.cheeks, paint.cheek_part * std::exp(-(at - cheek).squaredNorm() / (17 * 17)));
    const Vector3f lid = face.lid_upper[side] + Vector3f(0, 3.5F, 0);
    const Vector3f away = (at - lid).cwiseQuotient(Vector3f(14, 4.5F, 14));
    cover.add(paint.lids, paint.lid_part * std::exp(-away.squaredNorm()));
  }
  cover.add(paint.lips, paint.lip_part * smooth_step(0.35F, 0.7F, lips));
}

}  // namespace

Person make_person(const Look& look, std::uint64_t seed) {
  Random random(seed, 51);
  const int drawn = 1 + random.below(6);
  const int type = look.skin_type == Look::kAnyType ? drawn : look.skin_type;
  const TypologyRange range = typology_of_type(type);
  Person person;
  person.skin.blood = kBlood * random.uniform(0.8F, 1.3F);
  person.skin.melanin = skin_optics().melanin_of(
      range.middle_deg + 0.7F * range.half_width_deg * random.uniform(-1, 1), person.skin.blood);
  person.complexion.skin = skin_optics().albedo(person.skin);
  person.complexion.hair = hair_colour(type, random);
  person.complexion.iris = iris_colour(type, random);
  const float freckled = random.uniform();
  person.freckles = type <= 3 ? freckled * freckled : 0.15F * freckled;
  const bool bearded = random.uniform() < 0.5F;
  const float length = random.uniform();
  if (bearded) {
    person.beard_mm = length < 0.6F ? 0.4F + 1.6F * length : 2.0F + 12 * (length - 0.6F);
  }
  person.complexion.beard = bearded ? 0.5F : 0.0F;
  person.makeup = look.makeup && !bearded && random.uniform() < 0.5F;
  return person;
}

SkinMaps map_skin(const Anatomy& anatomy, const Person& person, const Look& look, const SkinZones& zones,
                  const Eigen::Matrix3Xf& resting_mm, std::uint64_t seed) {
  Random random(seed, 52);
  const Noise blotches(seed, 43);
  const Noise mottle(seed, 44);
  const Noise fine(seed, 45);
  const Noise strands(seed, 46);
  const Noise freckle(seed, 47);
  const Noise edge(seed, 48);
  const Paint paint = make_paint(person, seed);
  const std::vector<Spot> moles =
      look.marks ? make_moles(zones, resting_mm, person.freckles, random) : std::vector<Spot>{};
  const Vector3f bridge = 0.5F * (anatomy.nasion + anatomy.nose_tip);
  const Eigen::Index count = resting_mm.cols();
  SkinMaps maps{Eigen::VectorXf(count), Eigen::VectorXf(count), Eigen::VectorXf(count),
                Eigen::Matrix3Xf(3, count), Eigen::VectorXf(count)};
  render::for_each_row(static_cast<int>((count + 511) / 512), [&](int block) {
    const Eigen::Index end = std::min<Eigen::Index>(count, (static_cast<Eigen::Index>(block) + 1) * 512);
    for (Eigen::Index v = static_cast<Eigen::Index>(block) * 512; v < end; ++v) {
      const Vector3f at = resting_mm.col(v);
      const float lips = smooth_step(0.25F, 0.75F, zones.lips[v]);
      float melanin = person.skin.melanin * melanin_of_place(anatomy, at);
      float blood = person.skin.blood * blood_of_place(anatomy, at);
      if (look.marks) {
        melanin *= 1 + 0.16F * blotches.fractal(at / 26.0F, 3) + 0.07F * fine.fractal(at / 3.4F, 2);
        blood *= std::max(0.3F, 1 + 0.35F * mottle.fractal(at / 12.0F, 3) + 0.2F * fine.at(at / 1.9F));
        const float sunny = std::exp(-(at - bridge).cwiseQuotient(Vector3f(48, 26, 40)).squaredNorm());
        const float rare = 0.85F - 0.5F * person.freckles * sunny;
        melanin += 0.02F * sunny * smooth_step(rare, rare + 0.25F, freckle.at(at / 2.0F));
        for (const Spot& mole : moles) {
          const float distance = (at - mole.at_mm).norm() / mole.radius_mm;
          melanin += distance < 1.4F ? mole.melanin * smooth_step(1.3F, 0.6F, distance) : 0.0F;
        }
      }
      // Lips have a thin epidermis, so that blood shows; in dark skins melanin stays.
      const float creases = 1 + 0.14F * fine.at({at.x() / 1.4F, at.y() / 7.0F, at.z() / 7.0F});
      melanin *= 1 - 0.25F * lips;
      blood += lips * creases * (12.0F * person.skin.blood - blood);
      const float margin = smooth_step(0.05F, 0.3F, zones.eye[v]);
      melanin *= 1 - 0.5F * margin;
      blood *= 1 + 2.0F * margin;

      // The red of the lips scatters little, which two layers of skin do not know: what lies deep stays
      // there.
      Cover cover;
      const Vector3f deep = skin_optics().albedo({0.9F * melanin, 12.0F * person.skin.blood});
      cover.add(creases * deep.cwiseProduct(Vector3f(0.92F, 0.6F, 0.62F)), 0.65F * lips);
      if (person.makeup) {
        put_makeup(anatomy, paint, at, zones.lips[v], cover);
      }
      if (!look.strands) {
        paint_hairs(anatomy, person, at, zones, v, strands, cover);
      }
      cover.add({0.24F, 0.07F, 0.065F}, smooth_step(0.3F, 0.8F, zones.mouth[v]));
      const float hairline =
          above_hairline_mm(anatomy, at, zones.skin[v]) + 4.0F * edge.fractal(at / 8.0F, 3);
      const float strand = strands.fractal({at.x() / 1.3F, at.y() / 14.0F, at.z() / 9.0F}, 2);
      cover.add(person.complexion.hair * std::max(0.3F, 1 + 0.55F * strand),
                smooth_step(-2.0F, look.strands ? 9.0F : 4.0F, hairline));

      maps.melanin[v] = melanin;
      maps.blood[v] = blood;
      maps.cover[v] = cover.part();
      maps.over.col(v) = cover.colour();
      const float zone =
          std::exp(-((at - anatomy.nose_tip).cwiseQuotient(Vector3f(14, 24, 30))).squaredNorm()) +
          std::exp(-((at - anatomy.forehead).cwiseQuotient(Vector3f(34, 34, 60))).squaredNorm());
      maps.oil[v] = 0.8F + 0.55F * std::min(zone, 1.0F) + 0.5F * lips + 0.25F * mottle.fractal(at / 9.0F, 2);
    }
  });
  return maps;
}

Eigen::Matrix3Xf skin_albedo(const SkinMaps& maps, const Eigen::VectorXf& blood_flow) {
  const SkinOptics& optics = skin_optics();
  const Eigen::Index count = maps.melanin.size();
  Eigen::Matrix3Xf albedo(3, count);
  render::for_each_row(static_cast<int>((count + 4095) / 4096), [&](int block) {
    const Eigen::Index end = std::min<Eigen::Index>(count, (static_cast<Eigen::Index>(block) + 1) * 4096);
    for (Eigen::Index v = static_cast<Eigen::Index>(block) * 4096; v < end; ++v) {
      const float flow = blood_flow.size() > 0 ? blood_flow[v] : 1.0F;
      const Vector3f skin = optics.albedo({maps.melanin[v], flow * maps.blood[v]});
      albedo.col(v) = skin + maps.cover[v] * (maps.over.col(v) - skin);
    }
  });
  return albedo;
}

}  // namespace facet::simulation
