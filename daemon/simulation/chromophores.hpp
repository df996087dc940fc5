#pragma once

#include <Eigen/Core>
#include <vector>

namespace facet::simulation {

/// What colours a patch of skin.
struct Chromophores {
  float melanin = 0;  ///< part of the epidermis's volume that is melanosomes
  float blood = 0;    ///< part of the dermis's volume that is blood
};

/// The colour of skin as a function of its melanin and blood: two layers, an epidermis of fixed thickness
/// over a dermis without end, with the absorption and scattering of [DJ06], each solved after Kubelka and
/// Munk [KM31], inner reflection at the surface after Saunderson [Sau42]; seen under D65. Tabulated once.
/// Immutable; any thread.
class SkinOptics {
 public:
  SkinOptics();

  static constexpr float kMaxMelanin = 0.6F;
  static constexpr float kMaxBlood = 0.25F;

  /// Diffuse reflectance, linear RGB (sRGB's primaries), 0.001 to 1. Values beyond the maxima are clamped.
  Eigen::Vector3f albedo(const Chromophores& skin) const;
  /// The melanin that gives an individual typology angle at so much blood, by bisection.
  float melanin_of(float typology_deg, float blood) const;

 private:
  Eigen::Matrix3Xf table_;  ///< [3][kSteps * kSteps], blood running faster
};

/// One for the process.
const SkinOptics& skin_optics();

/// The individual typology angle [CCH91] of a linear RGB colour, degrees: atan((L* - 50) / b*) under D65.
/// Above 55 very light, 41 light, 28 intermediate, 10 tan, -30 brown, below dark.
float typology_deg(const Eigen::Vector3f& linear_rgb);

/// The middle of the angles of a Fitzpatrick type, 1 to 6, and half their width; degrees.
struct TypologyRange {
  float middle_deg = 0;
  float half_width_deg = 0;
};
TypologyRange typology_of_type(int skin_type);

}  // namespace facet::simulation
