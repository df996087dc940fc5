#pragma once

#include <Eigen/Geometry>
#include <vector>

#include "face/face_model.hpp"
#include "person/keyframes.hpp"
#include "report/evaluation.hpp"
#include "simulation/actor_sequence.hpp"

namespace facet::person {

/// An actor who turns calmly in small pictures, and then holds still under lamps that fire in turn, as
/// enrolment gets to see it.
simulation::ActorSequenceConfig actors_turn();

inline constexpr double kShort = 0.85;

/// What a tracker that guesses a mean face and a focal length that is short by kShort would have of an
/// actor's calm turn: seven pictures, and one under each of the four lamps.
Observed look_at(const face::FaceModel& model, const simulation::ActorSequence& actor);

/// The same of any pictures of an actor who acts: with the expressions that he has.
Observed look_at(const face::FaceModel& model, const simulation::ActorSequence& actor,
                 const std::vector<int>& frames);

/// Mean distance of the skin from the actor's face at rest, mm.
double error_mm(const face::FaceModel& model, const Eigen::Matrix3Xd& neutral_mm, const report::Truth& truth);

}  // namespace facet::person
