#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "model/head_mesh.hpp"
#include "model/identity_sampler.hpp"
#include "model/makehuman_data.hpp"

namespace facet::model {

/// One expression by its ARKit name.
struct ExpressionName {
  const char* name;
  float sigma;          ///< typical weight in captured performances, for priors
  const char* made_of;  ///< for docs/face-model.md and `facet model info`
};

/// The 51 ARKit expressions that MakeHuman's units can make; tongueOut is the one that they can't.
const std::vector<ExpressionName>& expression_names();

/// Expression shapes on one neutral head, for each ethnicity: displacements of skin, inner mouth and sockets.
/// The eyeballs stay at rest here: rotate_eyeballs() moves them on each head by itself.
class ExpressionShapes {
 public:
  /// neutral_mm [3][vertex_count] the head that the shapes belong to (IdentitySampler::average()).
  ExpressionShapes(const MakeHumanTargets& targets, const HeadMesh& head, const Eigen::Matrix3Xd& neutral_mm);

  /// Displacements, mm, of one expression for a mixture of ethnicities (weights of kEthnicities, sum 1).
  Eigen::Matrix3Xd blend_mm(int expression, const std::array<double, 3>& ethnicity) const;

 private:
  std::array<std::vector<Eigen::Matrix3Xd>, 3> shapes_mm_;  // [ethnicity][expression]
};

/// Adds to the displacements what an eyeLook expression does to the eyeballs of a head: a turn about their
/// centres.
void rotate_eyeballs(int expression, const HeadMesh& head, const Eigen::Matrix3Xd& neutral_mm,
                     Eigen::Matrix3Xd& displacements_mm);

}  // namespace facet::model
