#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace facet::simulation {

struct Gloss {
  float reflectance = 0;  ///< at normal incidence
  float roughness = 1;
};

/// The mirrored part of a light of unit irradiance: Torrance-Sparrow with the GGX distribution [WMLT07],
/// Smith's masking and Schlick's reflectance, times cosine and pi (the convention of [MD19 eq. 1]: a white
/// surface facing a light of irradiance 1 shows 1).
inline float mirrored(const Eigen::Vector3f& normal, const Eigen::Vector3f& to_light,
                      const Eigen::Vector3f& to_eye, const Gloss& gloss) {
  constexpr float kPi = std::numbers::pi_v<float>;
  const float cos_light = normal.dot(to_light);
  const float cos_eye = std::max(normal.dot(to_eye), 0.05F);
  if (cos_light <= 0) {
    return 0;
  }
  const Eigen::Vector3f half = (to_light + to_eye).normalized();
  const float alpha = gloss.roughness * gloss.roughness;
  const float alpha2 = alpha * alpha;
  const float cos_half = std::max(normal.dot(half), 0.0F);
  const float spread = cos_half * cos_half * (alpha2 - 1) + 1;
  const float distribution = alpha2 / (kPi * spread * spread);
  const auto masking = [&](float cosine) {
    return 2 * cosine / (cosine + std::sqrt(alpha2 + (1 - alpha2) * cosine * cosine));
  };
  const float fresnel =
      gloss.reflectance + (1 - gloss.reflectance) * std::pow(1 - std::max(half.dot(to_eye), 0.0F), 5.0F);
  return distribution * masking(cos_light) * masking(cos_eye) * fresnel / (4 * cos_eye) * kPi;
}

}  // namespace facet::simulation
