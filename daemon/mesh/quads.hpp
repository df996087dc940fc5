#pragma once

#include "mesh/mesh.hpp"

namespace facet::mesh {

/// The quads split into triangles (0, 1, 2), (0, 2, 3).
Triangles split_quads(const Quads& quads);

}  // namespace facet::mesh
