#pragma once

#include "animate/influence.hpp"
#include "studio/studio.hpp"

namespace facet::studio {

/// A colour for each control point's region, and their mixture at every vertex.
RegionColours colours_of(const animate::InfluenceMaps& maps);

}  // namespace facet::studio
