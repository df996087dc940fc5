#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "animate/take_basis.hpp"

namespace facet::animate {

/// Vertices that people call by name, found on the mean face by the subject's regions: "mouth-left" and
/// "mouth-right" (corners; the subject's sides), "lip-upper", "lip-lower", "brow-left", "brow-right", "nose",
/// "chin". Those that the mesh lacks are left out. Vertices of the finest level.
std::vector<std::pair<std::string, std::int32_t>> places(const TakeBasis& basis);

/// The vertex that a text names, by number or as a place. Throws Error(Usage) that lists the places.
std::int32_t find_vertex(const TakeBasis& basis, const std::string& text);

}  // namespace facet::animate
