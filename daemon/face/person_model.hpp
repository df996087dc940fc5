#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "mesh/mesh_frame.hpp"

namespace facet::face {

/// The face model of one person: no identity to choose, the person's own neutral face and expressions carried
/// over to it [SP04]. Tracker, refinement, exports and retargeting run on it as on any model.
///
/// model       whose topology, landmarks, albedo and expressions it takes
/// identity    [identity_count] of the model's face that the person's was found from
/// neutral_mm  [3][vertex_count] the person's, in that face's place and turn
/// name        for people
/// Half a second.
FaceModel person_model(const FaceModel& model, const std::vector<float>& identity,
                       const Eigen::Matrix3Xd& neutral_mm, const std::string& name);

/// The blend shapes of a mesh's subject: what the model makes of its identity, or, where the person's own
/// shape was learned, of that. A subject of another model has no expressions, or ones that its frames don't
/// agree with. Half a second for a person's own.
ExpressionBasis expressions_of(const FaceModel& model, const mesh::Subject& subject);

/// Moves eyeballs, teeth and tongue, whatever is no one piece with the skin, by what the skin next to them
/// moved. neutral_mm [3][vertex_count] in place; from_mm the face before.
void bring_loose_pieces(const FaceModel& model, const Eigen::Matrix3Xd& from_mm,
                        Eigen::Matrix3Xd& neutral_mm);

}  // namespace facet::face
