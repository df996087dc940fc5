#pragma once

// Private to this room: albedo, lamps and exposures of a head that turned, or was lit in turn.

#include <Eigen/Core>
#include <array>
#include <vector>

#include "person/skin_light.hpp"

namespace facet::person {

/// What keyframes show of texels, and what is held of these.
struct SkinSamples {
  std::array<Eigen::MatrixXf, 3> rgb;  ///< [keyframes][texels] linear
  Eigen::MatrixXf weight;              ///< [keyframes][texels] 0: the picture does not show it
  Eigen::MatrixXf shading;             ///< [keyframes][texels] without exposure
  Eigen::Matrix3Xf model;              ///< [3][texels] the model's mean albedo
  Eigen::Matrix3Xf albedo;             ///< [3][texels]
  Eigen::ArrayXf seen;                 ///< [texels] pictures' worth of weight

  float brightness(Eigen::Index keyframe, Eigen::Index texel) const;
  float albedo_brightness(Eigen::Index texel) const;
};

/// Of linear RGB what skin is judged by: red and green alike. Blue is noisy and shows what is below the skin.
float brightness(const Eigen::Vector3f& rgb);

/// Solves I_kt = g_k E_kt(lamps) rho_t for lamps, exposures g and albedo rho, each with the others held, by
/// Tukey-weighted least squares [MD19 eq. 1] with lamps for its harmonics. Light times albedo is all that
/// pictures show: the albedo's brightness is the model's. One thread.
class SkinAlbedo {
 public:
  /// gains             [keyframe] to begin with
  /// usual_brightness  of the pictures where they show skin
  /// usual_albedo      of the model there
  SkinAlbedo(const SkinLight& light, Eigen::VectorXf gains, float usual_brightness, float usual_albedo);

  /// Tukey's bound on a residual, over the usual brightness.
  void set_bound(float bound) { bound_ = bound; }

  /// rows  [kLamps][samples' texels] of SkinLight. The samples' shading follows.
  void solve_lamps(SkinSamples& samples, const Eigen::MatrixXf& rows);
  void solve_gains(SkinSamples& samples);
  /// first: what is held of the albedo is the model's, which has neither these brows nor this beard; nothing
  /// is far off.
  void solve_albedo(SkinSamples& samples, bool first);

  const Eigen::MatrixXd& lamps() const { return lamps_; }  ///< [kLamps][rooms] camera frame
  const Eigen::VectorXf& gains() const { return gains_; }
  float usual_brightness() const { return usual_; }
  /// Of the face: brightness over the model's albedo.
  float usual_shading() const { return usual_ / usual_albedo_; }
  /// The model's mean albedo has this hue, against its own.
  const Eigen::Array3f& hue() const { return hue_; }
  /// Rms of what lamps, exposures and albedo leave unexplained, over the usual brightness.
  double residual(const SkinSamples& samples) const;

 private:
  float believed(const SkinSamples& samples, Eigen::Index keyframe, Eigen::Index texel) const;
  void solve_room(const SkinSamples& samples, const Eigen::MatrixXf& rows, Eigen::Index room);
  void scale_lamps(SkinSamples& samples, float factor);
  void normalise(SkinSamples& samples);

  const SkinLight& light_;
  Eigen::MatrixXd lamps_;
  Eigen::VectorXf gains_;
  Eigen::Array3f hue_{1, 1, 1};
  float usual_, usual_albedo_;
  float bound_ = 1;
  bool lit_ = false;
};

}  // namespace facet::person
