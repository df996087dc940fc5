#include "simulation/chromophores.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace facet::simulation {
namespace {

constexpr int kSteps = 48;  // of the table, along melanin and blood
constexpr int kBands = 31;  // 400 to 700 nm by 10
using Bands = Eigen::Array<double, kBands, 1>;

/// Molar extinction of oxygenated and deoxygenated haemoglobin, 1/(cm M), after Prahl's compilation of
/// Gratzer's and Kollias's measurements.
const Bands& oxyhaemoglobin() {
  static const Bands values =
      (Bands() << 266232, 466840, 480360, 246072, 102580, 62816, 44480, 33209.2, 26629.2, 23684.4, 20932.8,
       20035.2, 24202.4, 39956.8, 53236, 43016, 32613.2, 44496, 50104, 14400.8, 3200, 1506, 942, 610, 442,
       368, 319.6, 294, 277.6, 276, 290)
          .finished();
  return values;
}
const Bands& deoxyhaemoglobin() {
  static const Bands values =
      (Bands() << 223296, 303956, 407560, 528600, 413280, 103292, 23388.8, 16156.4, 14550, 16684, 20862,
       25773.6, 31589.6, 39036.4, 46592, 53412, 53788, 45072, 37020, 28324.4, 14677.2, 9443.6, 6509.6, 5148.8,
       4345.2, 3750.12, 3226.56, 2795.12, 2407.92, 2051.96, 1794.28)
          .finished();
  return values;
}

/// Daylight's relative power [CIE D65].
const Bands& daylight() {
  static const Bands values =
      (Bands() << 82.75, 91.49, 93.43, 86.68, 104.87, 117.01, 117.81, 114.86, 115.92, 108.81, 109.35, 107.80,
       104.79, 107.69, 104.41, 104.05, 100, 96.33, 95.79, 88.69, 90.01, 89.60, 87.70, 83.29, 83.70, 80.03,
       80.21, 82.28, 78.28, 69.72, 71.61)
          .finished();
  return values;
}

Bands wavelengths_nm() {
  return Bands::LinSpaced(kBands, 400, 700);
}

/// A bell whose two sides have widths of their own.
Bands bell(const Bands& at, double middle, double steepness_below, double steepness_above) {
  const Bands steepness = (at < middle).select(Bands::Constant(steepness_below), steepness_above);
  return (-0.5 * ((at - middle) * steepness).square()).exp();
}

/// Linear RGB of a reflectance under D65, white being (1, 1, 1): the CIE's 1931 observer in the form of
/// [WSS13] and sRGB's primaries.
Eigen::Matrix<double, 3, kBands> make_rgb_from_reflectance() {
  const Bands nm = wavelengths_nm();
  Eigen::Matrix<double, 3, kBands> xyz;
  xyz.row(0) = 0.362 * bell(nm, 442.0, 0.0624, 0.0374) + 1.056 * bell(nm, 599.8, 0.0264, 0.0323) -
               0.065 * bell(nm, 501.1, 0.0490, 0.0382);
  xyz.row(1) = 0.821 * bell(nm, 568.8, 0.0213, 0.0247) + 0.286 * bell(nm, 530.9, 0.0613, 0.0322);
  xyz.row(2) = 1.217 * bell(nm, 437.0, 0.0845, 0.0278) + 0.681 * bell(nm, 459.0, 0.0385, 0.0725);
  const Eigen::Matrix3d rgb_from_xyz =
      (Eigen::Matrix3d() << 3.2406, -1.5372, -0.4986, -0.9689, 1.8758, 0.0415, 0.0557, -0.2040, 1.0570)
          .finished();
  Eigen::Matrix<double, 3, kBands> rgb =
      rgb_from_xyz * xyz * Eigen::Matrix<double, kBands, 1>(daylight()).asDiagonal();
  const Eigen::Vector3d white = rgb.rowwise().sum();
  return white.cwiseInverse().asDiagonal() * rgb;
}

/// Absorption per mm of tissue without pigment [DJ06].
Bands bare_tissue(const Bands& nm) {
  return (0.244 + 85.3 * (-(nm - 154) / 66.2).exp()) / 10;
}

/// The layers' reflectance by wavelength.
Bands reflectance(double melanin, double blood) {
  constexpr double kEpidermis_mm = 0.1;
  constexpr double kEumelanin = 0.65;  // the rest of the melanin is pheomelanin
  constexpr double kOxygenated = 0.75;
  constexpr double kHaemoglobin_g_per_l = 150;
  constexpr double kHaemoglobin_g_per_mol = 64'500;
  constexpr double kInnerReflection = 0.493;  // of diffuse light at a refractive index of 1.4
  static const Bands nm = wavelengths_nm();
  static const Bands pigment =
      kEumelanin * 6.6e10 * nm.pow(-3.33) + (1 - kEumelanin) * 2.9e14 * nm.pow(-4.75);
  static const Bands haemoglobin = std::numbers::ln10 * kHaemoglobin_g_per_l / kHaemoglobin_g_per_mol / 10 *
                                   (kOxygenated * oxyhaemoglobin() + (1 - kOxygenated) * deoxyhaemoglobin());
  static const Bands bare = bare_tissue(nm);
  // Kubelka and Munk's S is three quarters of the reduced scattering, their K twice the absorption.
  static const Bands scattering = 0.75 * (14.74 * nm.pow(-0.22) + 2.2e11 * nm.pow(-4));

  const Bands dermis = 2 * (blood * haemoglobin + (1 - blood) * bare) / scattering;
  const Bands below = 1 + dermis - (dermis.square() + 2 * dermis).sqrt();
  const Bands a = 1 + 2 * (melanin * pigment + (1 - melanin) * bare) / scattering;
  const Bands b = (a.square() - 1).sqrt();
  const Bands depth = b * scattering * kEpidermis_mm;
  const Bands divisor = a * depth.sinh() + b * depth.cosh();
  const Bands back = depth.sinh() / divisor;
  const Bands through = b / divisor;
  const Bands inside = back + through.square() * below / (1 - back * below);
  return (1 - kInnerReflection) * inside / (1 - kInnerReflection * inside);
}

/// The table's steps grow with the square: thin pigment colours most.
float value_of(int step, float maximum) {
  const float part = static_cast<float>(step) / (kSteps - 1);
  return maximum * part * part;
}
float step_of(float value, float maximum) {
  return (kSteps - 1) * std::sqrt(std::clamp(value / maximum, 0.0F, 1.0F));
}

}  // namespace

SkinOptics::SkinOptics() : table_(3, kSteps * kSteps) {
  const Eigen::Matrix<double, 3, kBands> rgb = make_rgb_from_reflectance();
  for (int m = 0; m < kSteps; ++m) {
    for (int h = 0; h < kSteps; ++h) {
      const Bands seen = reflectance(static_cast<double>(value_of(m, kMaxMelanin)),
                                     static_cast<double>(value_of(h, kMaxBlood)));
      table_.col(m * kSteps + h) = (rgb * seen.matrix()).cast<float>().cwiseMax(0.001F).cwiseMin(1.0F);
    }
  }
}

Eigen::Vector3f SkinOptics::albedo(const Chromophores& skin) const {
  const float m = step_of(skin.melanin, kMaxMelanin);
  const float h = step_of(skin.blood, kMaxBlood);
  const int m0 = std::min(static_cast<int>(m), kSteps - 2);
  const int h0 = std::min(static_cast<int>(h), kSteps - 2);
  const float um = m - static_cast<float>(m0);
  const float uh = h - static_cast<float>(h0);
  const auto at = [&](int dm, int dh) { return table_.col((m0 + dm) * kSteps + h0 + dh); };
  return (1 - um) * ((1 - uh) * at(0, 0) + uh * at(0, 1)) + um * ((1 - uh) * at(1, 0) + uh * at(1, 1));
}

float SkinOptics::melanin_of(float typology, float blood) const {
  float low = 0;
  float high = kMaxMelanin;
  for (int k = 0; k < 30; ++k) {
    const float middle = 0.5F * (low + high);
    (typology_deg(albedo({middle, blood})) > typology ? low : high) = middle;
  }
  return 0.5F * (low + high);
}

const SkinOptics& skin_optics() {
  static const SkinOptics optics;
  return optics;
}

float typology_deg(const Eigen::Vector3f& linear_rgb) {
  // Of XYZ over the white's: Y and Z are all that L* and b* need.
  const float y = linear_rgb.dot(Eigen::Vector3f(0.2126F, 0.7152F, 0.0722F));
  const float z = linear_rgb.dot(Eigen::Vector3f(0.0193F, 0.1192F, 0.9505F)) / 1.089F;
  const auto f = [](float value) {
    return value > 0.008856F ? std::cbrt(value) : 7.787F * value + 16.0F / 116;
  };
  const float lightness = 116 * f(y) - 16;
  const float yellow = 200 * (f(y) - f(z));
  return std::atan2(lightness - 50, yellow) * 180 / std::numbers::pi_v<float>;
}

TypologyRange typology_of_type(int skin_type) {
  constexpr std::array<TypologyRange, 6> kRanges{
      {{58, 3}, {48, 6}, {34.5F, 6}, {19, 8}, {-10, 18}, {-45, 12}}};
  return kRanges.at(static_cast<std::size_t>(skin_type - 1));
}

}  // namespace facet::simulation
