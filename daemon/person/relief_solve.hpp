#pragma once

// Private to this room: photometric stereo on a chart's texels.

#include <Eigen/Core>
#include <cstddef>
#include <span>

#include "person/texel_grid.hpp"

namespace facet::person {

/// What pictures under several lights tell of texels: where a displacement d rises by u = d(right) - d and
/// v = d(below) - d, picture k is to have the brightness
///   I_k = rho (E_k + U_k u + V_k v)
/// All [pictures][texel_count].
struct ShadedPictures {
  Eigen::MatrixXf brightness;  ///< I, linear
  Eigen::MatrixXf weight;      ///< 0: the picture does not show the texel
  Eigen::MatrixXf shading;     ///< E, with the picture's exposure
  Eigen::MatrixXf slope_u;     ///< U, 1/mm
  Eigen::MatrixXf slope_v;     ///< V, 1/mm
};

/// What the texels' albedo is without the pictures: it counts as `counts` of squared shading.
struct AlbedoPrior {
  Eigen::ArrayXf brightness;  ///< [texel_count]
  float counts = 0;
  float usual_brightness = 1;  ///< of the pictures; residuals are told in it
};

/// What the relief is without the pictures, with distances in texels:
///   (curvature |L d|^2 + slope (u^2 + v^2)) / texel_mm^2 + position d^2
struct ReliefPrior {
  double texel_mm = 1;
  double curvature = 0.1;
  double slope = 0.1;
  double position = 1e-2;
};

/// Of each texel what is to be minimised over its slope's change s = (u, v): s . H s / 2 - b . s
struct SlopeSystem {
  Eigen::ArrayXf uu, uv, vv;  ///< [texel_count] H
  Eigen::ArrayXf u, v;        ///< [texel_count] b
};

/// Gauss-Newton about a displacement, with the albedo eliminated (its Schur complement) and Tukey's weights.
///
/// relief_mm  [texel_count]
/// bound      Tukey's, of the usual brightness
/// counts     [pictures] what each weighs; empty: 1
SlopeSystem slope_system(const TexelGrid& grid, const ShadedPictures& pictures, const AlbedoPrior& albedo,
                         const Eigen::VectorXd& relief_mm, float bound, std::span<const float> counts = {});

/// What the pictures say of the texels' albedo where the skin has a relief, [texel_count]: its brightness.
/// The prior's where a texel has no neighbour to the right or below.
Eigen::ArrayXf albedo_with_relief(const TexelGrid& grid, const ShadedPictures& pictures,
                                  const AlbedoPrior& albedo, const Eigen::VectorXd& relief_mm, float bound);

/// The change of relief_mm [texel_count] that the system and the prior ask for: conjugate gradients, 200 at
/// most.
Eigen::VectorXd relief_step(const TexelGrid& grid, const SlopeSystem& system, const ReliefPrior& prior,
                            const Eigen::VectorXd& relief_mm);

/// How far the relief that one half of the pictures tells is what the others show, and the other way round:
/// of both s . b over s . H s, with s the slopes of one and H, b of the other. 1 and more where it is, about
/// 0 where it is noise.
///
/// halves  [pictures] 0 or 1
double agreement_of_halves(const TexelGrid& grid, const ShadedPictures& pictures, const AlbedoPrior& albedo,
                           const ReliefPrior& prior, std::span<const char> halves, float bound);

}  // namespace facet::person
