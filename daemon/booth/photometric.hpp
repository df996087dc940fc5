#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "capture/rig.hpp"
#include "facet/frame_set.hpp"
#include "fit/template_mesh.hpp"
#include "mesh/hierarchy.hpp"

namespace facet::booth {

/// A slot that known lights lit, between two blank ones.
struct LitSlot {
  const FrameSet* set = nullptr;    ///< frames in the rig's order
  double fraction = 0;              ///< of the time from the blank slot before to the one after, 0 to 1
  std::vector<std::string> lights;  ///< names of the rig's projectors and lights; none: dark
};

/// How far lights, depth and smoothness are believed. Of the energy see PhotometricStereo.
struct PhotometricOptions {
  float sigma_light = 0.04F;     ///< standard deviation of a picture's light about the model's, relative
  float sigma_albedo = 0.03F;    ///< of what earlier slots say of a vertex's albedo, at best, relative
  float sigma_depth_mm = 0.12F;  ///< of the depths' displacement, per square millimetre of skin
  float sigma_bend = 0.5F;       ///< of the Laplacian of what is added, 1/mm, per square millimetre
  float robust = 0.25F;          ///< Tukey's bound, relative: what is off by more is shadow, gloss or hair
  float least_agreement = 0.3F;  ///< of a lit slot's pictures with its lights, a correlation
  int steps = 2;                 ///< Gauss-Newton
  int cg_iterations = 60;        ///< a step, at most
};

/// Photometric stereo on the tracked mesh: what the pictures of slots under different known lights, blank
/// ones among them, say of the skin's slopes ([Woo80]; near lamps and shadows as [QDC18]). Per vertex and
/// camera the albedo rho is eliminated; what several lights say together, whatever their number, is a 2 x 2
/// matrix and a vector about the slopes s = G e of what is added to the displacements:
///   E(e) = sum over i of A_i (1/2 s_i^T H_i s_i - b_i^T s_i) + sum A_i e_i^2 / (2 sigma_depth^2)
///          + sum A_i (Laplacian e)_i^2 / (2 sigma_bend^2),
///   H = sum over cameras of (J^T W J - J^T W t t^T W J / (t^T W t + kappa)),  J = rho dt/ds,
///   t_l = n . L_l + ambient light, L_l = sum of the slot's lamps of strength, shadow and fall-off,
/// with kappa what earlier slots know of the albedo. Strengths and ambient light are fitted to the mesh that
/// depth gave. All cameras see, monochrome ones too. One thread at a time; two work inside.
class PhotometricStereo {
 public:
  /// Throws Error(Unavailable) without Embree, which casts the shadows.
  PhotometricStereo(std::shared_ptr<const capture::Rig> rig, const PhotometricOptions& options);
  ~PhotometricStereo();

  /// A new person. hierarchy: of fit::FineSurface over `surface`.
  void begin(std::shared_ptr<const mesh::Hierarchy> hierarchy, const fit::TemplateMesh& surface);

  /// blank             the blank slot, frames in the rig's order
  /// lit               the lit slots between the blank slot before and this one
  /// before_mm         [3][template vertex_count] the blank slot before, rig frame
  /// now_mm            the same of this one
  /// displacements_mm  [finest vertex_count] along the normals of the template subdivided, by depth
  /// added_mm          out: [finest vertex_count] what light adds to them; all 0 where it says nothing
  /// Returns why a slot is not believed, for people; empty where all is well.
  std::string refine(const FrameSet& blank, std::span<const LitSlot> lit, const mesh::Vertices& before_mm,
                     const mesh::Vertices& now_mm, std::span<const float> displacements_mm,
                     std::vector<float>& added_mm);

  /// How bright a light was found to be in slots that it lit alone, of what the rig file says, where blank
  /// slots' projectors have 1 on the mean; 0: none was.
  double strength_of(const std::string& light) const;
  /// Room light that skin gets which faces the cameras (+z of the rig), in the same measure.
  double ambient() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::booth
