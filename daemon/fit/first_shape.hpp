#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "face/face_model.hpp"
#include "fit/template_mesh.hpp"

namespace facet::fit {

/// A face of the face model: who it is, and what it does. Head frame.
struct FirstShape {
  mesh::Vertices neutral_mm;              ///< [3][control vertex_count] at rest
  mesh::Vertices shown_mm;                ///< [3][control vertex_count] as it is seen
  std::vector<mesh::Vertices> deltas_mm;  ///< [expression_count] of [3][control vertex_count], this person's
  Eigen::VectorXd expression;             ///< [expression_count] 0 to 1: what shown_mm does beyond neutral_mm
};

/// The model's mean face at rest.
FirstShape mean_shape(const face::FaceModel& model);

/// Those of the correspondences that an open jaw leaves where they are: whom it does not move by more than
/// 2 mm. All of them where the model has no "jawOpen".
std::vector<Correspondence> above_the_jaw(const face::FaceModel& model,
                                          std::span<const Correspondence> correspondences);

/// Identity and expression that bring the model's landmarks to points in space, each in the model's own
/// spread: pose and scale by align_rigidly, then all coefficients at once by a ridge solve, in turns, with
/// Cauchy's weights for what lies far off. A take's first face need not be at rest, and another person's
/// shape must not pass for an expression (docs/template-fit.md, "The first slot"). Expressions are linear
/// around the mean person. Allocates; 0.1 s. Any thread. correspondences: with places on the model alone.
/// jaw_open: the weight of "jawOpen" is held there.
FirstShape find_first_shape(const face::FaceModel& model, std::span<const Correspondence> correspondences,
                            std::optional<double> jaw_open = {});

}  // namespace facet::fit
