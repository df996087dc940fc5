#pragma once

// Private to this room: what a subject must be, and its albedo at the start.

#include <span>
#include <vector>

#include "refine/refiner.hpp"
#include "shaders/common/layout.h"

namespace facet::refine {

/// Throws Error(Usage) where parts of the subject do not fit each other or the configuration.
void check(const RefinerConfig& config, const SubjectSetup& subject);

/// Where the albedo of every level begins, [3][vertex_count]: the mean, in the skin's tone where that is
/// known, or the one known on the finest level. Of this one a vertex of a coarser level, which is also one of
/// the finer level, takes half of itself and half of its neighbours there, as the wider pixels that it is
/// compared with do.
std::vector<mesh::Vertices> albedo_of_levels(const SubjectSetup& subject);

/// Puts a skin's albedo, in the hue and brightness that frames have taught, in the place of what they have.
///
/// skin        [3][vertex_count]
/// counts      [vertex_count] how far frames have taught each
/// linear_rgb  [vertex_count][3] what they have taught
void take_hue(const mesh::Vertices& skin, std::span<const float> counts, std::vector<float>& linear_rgb);

/// LevelState::reliefs of every level, [3][vertex_count]: a coarser level has the finest one's relief as
/// albedo_of_levels() has its albedo. 0 where shading moves no vertex. Nothing where none is known.
std::vector<mesh::Vertices> relief_of_levels(const SubjectSetup& subject);

/// [M0's vertex count] 0 to 1: what the skin of M0 says of the light. Nothing where shading moves no vertex.
std::vector<float> counts_for_light(const SubjectSetup& subject);

/// [columns], each with the same fourth component.
std::vector<shaders::vec4> with_fourth(const mesh::Vertices& columns, float fourth);

}  // namespace facet::refine
