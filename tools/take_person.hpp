#pragma once

#include <string>

#include "face/face_model.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::tools {

/// What the model makes of a take's person: the neutral face and the expressions of the control vertices, in
/// the order of Subject::expression_names.
///
/// frame  a frame of the take with a mesh, by which the model is checked
/// model  its file; empty: the configured one
/// Throws Error(Usage) where the take has no expressions or the model is not the one that it was made with.
face::ExpressionBasis person_shapes(const mesh::MeshFrame& frame, const std::string& take,
                                    const std::string& model);

}  // namespace facet::tools
