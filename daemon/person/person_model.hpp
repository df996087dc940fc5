#pragma once

#include <Eigen/Core>
#include <vector>

#include "face/face_model.hpp"

namespace facet::person {

/// The face model of one person: no identity to choose, the person's own neutral face and expressions carried
/// over to it [SP04]. Tracker, refinement, exports and retargeting run on it as on any model.
///
/// model       whose topology, landmarks, albedo and expressions it takes
/// identity    [identity_count] of the model's face that the person's was found from
/// neutral_mm  [3][vertex_count] the person's, in that face's place and turn
/// name        for people
/// Half a second.
face::FaceModel person_model(const face::FaceModel& model, const std::vector<float>& identity,
                             const Eigen::Matrix3Xd& neutral_mm, const std::string& name);

/// Moves eyeballs, teeth and tongue, whatever is no one piece with the skin, by what the skin next to them
/// moved. neutral_mm [3][vertex_count] in place; from_mm the face before.
void bring_loose_pieces(const face::FaceModel& model, const Eigen::Matrix3Xd& from_mm,
                        Eigen::Matrix3Xd& neutral_mm);

}  // namespace facet::person
