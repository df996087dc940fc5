#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "face/face_model.hpp"
#include "face/face_parts.hpp"
#include "fit/template_mesh.hpp"
#include "mesh/hierarchy.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::booth {

/// What does not change of a person whom the template was fitted to (face::build_subject): control vertices
/// are the template's. No identity coefficients.
/// hierarchy  of the template (fit::FineSurface)
std::shared_ptr<const mesh::Subject> build_template_subject(const fit::TemplateMesh& surface,
                                                            std::shared_ptr<const mesh::Hierarchy> hierarchy,
                                                            const face::FaceModel& model,
                                                            std::uint32_t count);

/// The part of the face that each vertex of the template is of. model: with landmarks. [vertex_count]
std::vector<face::FacePart> template_parts(const fit::TemplateMesh& surface, const face::FaceModel& model);

}  // namespace facet::booth
