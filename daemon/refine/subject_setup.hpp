#pragma once

// Private to this room: what a subject must be, and its albedo at the start.

#include <vector>

#include "refine/refiner.hpp"
#include "shaders/common/layout.h"

namespace facet::refine {

/// Throws Error(Usage) where parts of the subject do not fit each other or the configuration.
void check(const RefinerConfig& config, const SubjectSetup& subject);

/// Mean albedo of every level, [3][vertex_count].
std::vector<mesh::Vertices> mean_albedo_of_levels(const SubjectSetup& subject);

/// Known albedo of every level from the finest one's, [3][vertex_count]. A vertex of a coarser level is also
/// one of the finer level; it takes half of itself and half of its neighbours there, as the wider pixels that
/// it is compared with do.
std::vector<mesh::Vertices> known_albedo_of_levels(const SubjectSetup& subject);

/// LevelState::reliefs of every level, [3][vertex_count]: a coarser level has the finest one's relief as
/// known_albedo_of_levels has its albedo. 0 where shading moves no vertex. Nothing where none is known.
std::vector<mesh::Vertices> relief_of_levels(const SubjectSetup& subject);

/// [M0's vertex count] 0 to 1: what the skin of M0 says of the light. Nothing where shading moves no vertex.
std::vector<float> counts_for_light(const SubjectSetup& subject);

/// [columns], each with the same fourth component.
std::vector<shaders::vec4> with_fourth(const mesh::Vertices& columns, float fourth);

}  // namespace facet::refine
