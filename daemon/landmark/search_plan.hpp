#pragma once

#include <vector>

#include "facet/frame.hpp"
#include "landmark/region.hpp"

namespace facet::landmark {

/// The windows of a search for faces in an image of this size, likely ones first: the whole image upright,
/// rows of overlapping tiles of its short side and of half of it, and these turned by a quarter or an eighth.
/// A face of 0.4 tiles lies whole in at least one. The first window is the whole image.
void list_search_windows(int width_px, int height_px, std::vector<Region>& windows);

}  // namespace facet::landmark
