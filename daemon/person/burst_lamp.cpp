#include "person/burst_lamp.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "light/lamps.hpp"
#include "person/chart_view.hpp"

namespace facet::person {
namespace {

using Eigen::ArrayXf;
using Eigen::Vector3f;

constexpr float kDegree = std::numbers::pi_v<float> / 180;
constexpr double kNothing = std::numeric_limits<double>::max();
/// Every so many-th texel tells of the lamp.
constexpr Eigen::Index kSampleStep = 40;
constexpr std::array<float, 5> kDistances_mm{300, 450, 650, 1000, 2000};
/// Steps of the search: to the sides, and of the distance's logarithm.
constexpr float kFirstTurn = 8 * kDegree;
constexpr float kCoarseTurn = 2 * kDegree;
constexpr float kLastTurn = 0.25F * kDegree;
constexpr float kFirstZoom = 0.3F;
constexpr int kMostSteps = 60;
/// A lamp behind the face's plane by more gives it nothing.
constexpr float kLeastFacing = -0.1F;
constexpr int kRounds = 4;
constexpr float kBound = 0.25F;  ///< Tukey's, of the usual brightness
/// What says that the exposure stayed, of what the dark picture says of it.
constexpr float kSameExposure = 0.02F;
constexpr float kLeastExposure = 0.3F;
/// Degrees between a normal and the bisector of lamp and camera within which skin mirrors the lamp.
constexpr float kMirrors_deg = 5;
constexpr float kMatt_deg = 15;
/// A texel that sees less of a lamp lies in its shadow or at the shadow's edge.
constexpr float kLit = 0.9F;
constexpr float kLeastLit = 0.02F;  ///< of the usual brightness, that a lamp gives a picture

float tukey(float t) {
  const float rest = 1 - t * t;
  return std::abs(t) < 1 ? rest * rest : 0;
}

Vector3f middle_of(const LitSurface& surface) {
  return surface.vertices_mm.rowwise().mean();
}

/// A lamp over the texels of one picture; places against the middle of the head's vertices, head frame.
class LampOver {
 public:
  LampOver(const LitSurface& surface, const Vector3f& place_mm, float reference_mm,
           const Eigen::Isometry3f& camera_from_head)
      : surface_(surface),
        lamp_mm_(camera_from_head.inverse() * place_mm - middle_of(surface)),
        eye_mm_(camera_from_head.inverse().translation() - middle_of(surface)),
        reference_mm_(reference_mm) {}

  /// [vertex_count] what each sees of it
  ArrayXf seen() const {
    return light::seen_from_lamp(surface_.vertices_mm, surface_.normals, surface_.triangles,
                                 lamp_mm_ + middle_of(surface_));
  }

  struct Given {
    Vector3f towards;          ///< unit
    light::Clamped clamped;    ///< of its cosine
    float open = 0, near = 0;  ///< V and (d_0 / d)^2
    float matt = 0;            ///< 0: the skin mirrors it to the camera; 1
  };

  Given at(Eigen::Index texel, const ArrayXf& seen) const {
    const SkinTexels& texels = surface_.texels;
    const Vector3f at_mm = texels.positions_mm.col(texel);
    const Vector3f normal = texels.normals.col(texel);
    const Eigen::Vector3i corners = texels.corners.col(texel);
    const Vector3f away = lamp_mm_ - at_mm;
    const float distance = std::max(away.norm(), 1.0F);
    Given out;
    out.towards = away / distance;
    out.clamped = light::clamped(normal.dot(out.towards));
    out.open = texels.shares.col(texel).dot(Vector3f(seen[corners[0]], seen[corners[1]], seen[corners[2]]));
    out.near = reference_mm_ * reference_mm_ / (distance * distance);
    const Vector3f bisector = (out.towards + (eye_mm_ - at_mm).normalized()).normalized();
    const float mirror_deg = std::acos(std::clamp(bisector.dot(normal), -1.0F, 1.0F)) / kDegree;
    out.matt = smoothstep(mirror_deg, kMirrors_deg, kMatt_deg);
    return out;
  }

 private:
  const LitSurface& surface_;
  Vector3f lamp_mm_, eye_mm_;
  float reference_mm_;
};

/// Some texels of a picture.
struct Samples {
  std::vector<Eigen::Index> texels;
  ArrayXf brightness, dark, weight, albedo;
};

Samples samples_of(const LitSurface& surface, const LitPicture& picture, const ArrayXf& dark,
                   const ArrayXf& albedo) {
  Samples out;
  for (Eigen::Index i = 0; i < surface.texels.count(); i += kSampleStep) {
    if (picture.weight[i] > 0) {
      out.texels.push_back(i);
    }
  }
  out.brightness = picture.brightness(out.texels);
  out.dark = dark(out.texels);
  out.weight = picture.weight(out.texels);
  out.albedo = albedo(out.texels);
  return out;
}

/// Exposure and strength of one picture under a lamp, and Tukey's loss of what is left.
struct Fit {
  float exposure = 1, strength = 0;
  double loss = kNothing;     ///< mean over what counts; kNothing: there is no such lamp
  double left = 0, lamp = 0;  ///< weighted squares of what is left, up to the bound's, and of I - r I_dark
};

/// shading  [texels of the samples] E; trust: likewise
Fit fit(const Samples& samples, const ArrayXf& shading, const ArrayXf& trust, float usual) {
  Fit out;
  const ArrayXf given = samples.albedo * shading;
  const ArrayXf weight = samples.weight * trust;
  const float bound = kBound * usual;
  for (int round = 0; round < kRounds; ++round) {
    const ArrayXf left = samples.brightness - out.exposure * samples.dark - out.strength * given;
    const ArrayXf w = round == 0 ? weight : weight * (left / bound).unaryExpr(&tukey);
    const float dd = (w * samples.dark.square()).sum();
    const float dg = (w * samples.dark * given).sum();
    const float gg = (w * given.square()).sum();
    const float prior = kSameExposure * dd;
    const float d = (w * samples.dark * samples.brightness).sum() + prior;
    const float g = (w * given * samples.brightness).sum();
    const float determinant = (dd + prior) * gg - dg * dg;
    if (!(determinant > 1e-6F * dd * gg)) {
      return {};
    }
    out.exposure = (gg * d - dg * g) / determinant;
    out.strength = ((dd + prior) * g - dg * d) / determinant;
  }
  if (!(out.strength > 0 && out.exposure > kLeastExposure)) {
    return {};
  }
  const ArrayXf lamp = samples.brightness - out.exposure * samples.dark;
  const ArrayXf left = ((lamp - out.strength * given).abs() / bound).min(1);
  out.loss = static_cast<double>((weight * (1 - (1 - left.square()).cube())).sum() /
                                 std::max(weight.sum(), std::numeric_limits<float>::min()));
  out.left = static_cast<double>((weight * (bound * left).square()).sum());
  out.lamp = static_cast<double>((weight * lamp.square()).sum());
  return out;
}

class LampSearch {
 public:
  LampSearch(const LitSurface& surface, std::span<const LitPicture> pictures, const ArrayXf& dark,
             const ArrayXf& albedo, float usual)
      : surface_(surface), pictures_(pictures), usual_(usual) {
    samples_.reserve(pictures.size());
    for (const LitPicture& picture : pictures) {
      samples_.push_back(samples_of(surface, picture, dark, albedo));
    }
    middle_mm_ = pictures.front().camera_from_head * middle_of(surface);
  }

  bool shows_all() const {
    return std::none_of(samples_.begin(), samples_.end(),
                        [](const Samples& samples) { return samples.texels.empty(); });
  }

  /// The best of each distance by the first picture, shadows as far lamps cast them.
  std::array<Vector3f, kDistances_mm.size()> coarse(const light::HeadVisibility& visibility) {
    std::array<double, kDistances_mm.size()> least;
    least.fill(kNothing);
    std::array<Vector3f, kDistances_mm.size()> best;
    best.fill(middle_mm_ - kDistances_mm.front() * middle_mm_.normalized());
    const Eigen::Matrix3f turn = pictures_.front().camera_from_head.linear();
    for (int d = 0; d < light::kRoomDirections; ++d) {
      const Vector3f towards = turn * light::room_directions().col(d);
      if (towards.dot(-middle_mm_.normalized()) < kLeastFacing) {
        continue;
      }
      const Eigen::Map<const Eigen::Array<std::uint8_t, Eigen::Dynamic, 1>> seen(visibility.of_direction(d),
                                                                                 surface_.vertices_mm.cols());
      for (std::size_t i = 0; i < kDistances_mm.size(); ++i) {
        const Vector3f place = middle_mm_ + kDistances_mm[i] * towards;
        const double loss = fit_of(0, place, seen.cast<float>() / 255).loss;
        if (loss < least[i]) {
          least[i] = loss;
          best[i] = place;
        }
      }
    }
    return best;
  }

  double loss(const Vector3f& place_mm) {
    const ArrayXf seen = seen_from(place_mm);
    double sum = 0;
    for (std::size_t k = 0; k < samples_.size(); ++k) {
      const double one = fit_of(k, place_mm, seen).loss;
      if (one == kNothing) {
        return kNothing;
      }
      sum += one;
    }
    return sum;
  }

  /// Steps to the sides, nearer and farther, that halve where none helps.
  Vector3f refined(Vector3f place_mm, float last_turn) {
    double least = loss(place_mm);
    float turn = kFirstTurn;
    float zoom = kFirstZoom;
    for (int step = 0; step < kMostSteps && turn > last_turn; ++step) {
      const Vector3f away = place_mm - middle_mm_;
      const Vector3f beside = turn * away.norm() * away.unitOrthogonal();
      const Vector3f above = away.normalized().cross(beside);
      Vector3f best = place_mm;
      const std::array<Vector3f, 6> tries{away + beside, away - beside,         away + above,
                                          away - above,  std::exp(zoom) * away, std::exp(-zoom) * away};
      for (std::size_t i = 0; i < tries.size(); ++i) {
        const float wanted = i < 4 ? away.norm() : tries[i].norm();  // sideways: as far away
        const Vector3f next = middle_mm_ + std::clamp(wanted, kDistances_mm.front(), kDistances_mm.back()) *
                                               tries[i].normalized();
        if (const double now = loss(next); now < least) {
          least = now;
          best = next;
        }
      }
      if (best == place_mm) {
        turn /= 2;
        zoom /= 2;
      }
      place_mm = best;
    }
    return place_mm;
  }

  BurstLamp at(const Vector3f& place_mm) {
    BurstLamp out{place_mm, reference_mm(place_mm), {}, {}, 1};
    const ArrayXf seen = seen_from(place_mm);
    double left = 0;
    double lamp = 0;
    for (std::size_t k = 0; k < samples_.size(); ++k) {
      const Fit found = fit_of(k, place_mm, seen);
      out.exposure.push_back(found.exposure);
      out.strength.push_back(found.strength);
      left += found.left;
      lamp += found.lamp;
    }
    out.unexplained = lamp > 0 ? static_cast<float>(std::sqrt(left / lamp)) : 1;
    return out;
  }

 private:
  float reference_mm(const Vector3f& place_mm) const { return (place_mm - middle_mm_).norm(); }

  /// The head is still: what the lamp sees in the first picture it sees in all.
  ArrayXf seen_from(const Vector3f& place_mm) const {
    return LampOver(surface_, place_mm, 1, pictures_.front().camera_from_head).seen();
  }

  Fit fit_of(std::size_t picture, const Vector3f& place_mm, const ArrayXf& seen) {
    const LampOver lamp(surface_, place_mm, reference_mm(place_mm), pictures_[picture].camera_from_head);
    const Samples& samples = samples_[picture];
    shading_.resize(samples.brightness.size());
    trust_.resize(shading_.size());
    for (Eigen::Index j = 0; j < shading_.size(); ++j) {
      const LampOver::Given given = lamp.at(samples.texels[static_cast<std::size_t>(j)], seen);
      shading_[j] = given.open * given.clamped.value * given.near;
      trust_[j] = given.matt;
    }
    return fit(samples, shading_, trust_, usual_);
  }

  const LitSurface& surface_;
  std::span<const LitPicture> pictures_;
  float usual_;
  std::vector<Samples> samples_;
  Vector3f middle_mm_;  ///< of the head, camera frame
  ArrayXf shading_, trust_;
};

}  // namespace

std::optional<BurstLamp> find_burst_lamp(const LitSurface& surface, const light::HeadVisibility& visibility,
                                         std::span<const LitPicture> pictures, const ArrayXf& dark,
                                         const ArrayXf& albedo, float usual_brightness) {
  LampSearch search(surface, pictures, dark, albedo, usual_brightness);
  if (!search.shows_all()) {
    return std::nullopt;
  }
  double least = kNothing;
  std::optional<Vector3f> best;
  for (const Vector3f& start : search.coarse(visibility)) {
    const Vector3f place_mm = search.refined(start, kCoarseTurn);
    if (const double loss = search.loss(place_mm); loss < least) {
      least = loss;
      best = place_mm;
    }
  }
  if (!best) {
    return std::nullopt;
  }
  BurstLamp out = search.at(search.refined(*best, kLastTurn));
  const LitPicture& first = pictures.front();
  const float lit = (first.weight * (first.brightness - out.exposure.front() * dark)).sum();
  if (!(lit > kLeastLit * usual_brightness * first.weight.sum())) {
    return std::nullopt;
  }
  return out;
}

LampShading lamp_shading(const LitSurface& surface, const BurstLamp& lamp,
                         const Eigen::Isometry3f& camera_from_head) {
  const LampOver over(surface, lamp.place_mm, lamp.reference_mm, camera_from_head);
  const ArrayXf seen = over.seen();
  const SkinTexels& texels = surface.texels;
  LampShading out;
  for (ArrayXf* values : {&out.shading, &out.slope_u, &out.slope_v, &out.trust}) {
    values->resize(texels.count());
  }
  for (Eigen::Index i = 0; i < texels.count(); ++i) {
    const LampOver::Given given = over.at(i, seen);
    const float full = given.open * given.near;
    out.shading[i] = full * given.clamped.value;
    out.slope_u[i] = -full * given.clamped.slope * given.towards.dot(texels.along_u.col(i));
    out.slope_v[i] = -full * given.clamped.slope * given.towards.dot(texels.along_v.col(i));
    out.trust[i] = smoothstep(given.open, kLit, 1) * given.matt;
  }
  return out;
}

}  // namespace facet::person
