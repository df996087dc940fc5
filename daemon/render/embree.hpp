#pragma once

namespace facet::render {

/// Embree's library is opened when the first ray is cast. What casts rays in the middle of its work asks at
/// its start: throws Error(Unavailable) naming the library and its package where it is not there.
void require_embree();

}  // namespace facet::render
