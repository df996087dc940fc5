#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "face/face_model.hpp"
#include "person/keyframes.hpp"
#include "person/shape_solver.hpp"

namespace facet::person {

/// A head's skin on the texture chart of its model (face_chart()), without the light that it was seen under.
struct Skin {
  /// Relief over the smooth surface, for a head of the generic face's size; 0 where little is seen.
  face::SkinChart chart;
  std::vector<float> seen;   ///< [height][width] pictures' worth of weight
  std::vector<float> gains;  ///< [keyframe] exposure against the mean of all
  double residual = 0;       ///< rms over brightness of what light and albedo leave unexplained
  double agreement = 0;      ///< agreement_of_halves()
  int lamps = 0;             ///< of a burst, whose place is known
  bool believed = false;     ///< both say that there is a relief; else it is 0
};

/// Finds a head's albedo and fine relief d from how its shading changed while it turned under a light that
/// stayed, and while lamps fired in turn (docs/person.md): lamps, exposures and albedo in turns, with the
/// shape that `solver` has; then the pictures are brought onto each other by their flow, and
///   sum_kt w_kt rho(I_kt - g_k rho_t E_k(n_t - grad d_t))^2 + (l_s |L d|^2 + l_g |grad d|^2) / texel^2
///     + l_0 |d|^2
/// is solved for d with rho_t eliminated at every texel: photometric stereo [Woo80]. Of a burst I - r I_dark
/// and the light of a lamp at a place that is found stand for I and E (BurstLamp). The albedo handed out is
/// what the pictures say of a skin with that relief.
///
/// chart_texels  of the chart's longer side
/// keyframes     with pictures; the solver's heads are theirs, all with the first one's expression
///               those of light 0 under lamps that stayed, each of the others under lamps of its own
/// between       called skin_pieces() times; may throw
/// Some ten seconds and 200 MB for 14 keyframes and 768 texels, three times that with 24 of a burst; any
/// thread.
Skin find_skin(const face::FaceModel& model, int chart_texels, const std::vector<Keyframe>& keyframes,
               const ShapeSolver& solver, const Eigen::Vector2d& centre_px,
               const std::function<void()>& between);

/// How often find_skin() calls between(). lights  of the burst; 0 without one
int skin_pieces(int keyframes, int lights);

}  // namespace facet::person
