#pragma once

#include <cstdint>
#include <vector>

#include "mesh/hierarchy.hpp"

namespace facet::test {

/// A control mesh with positions and the arguments that build_hierarchy takes with it.
struct Surface {
  mesh::ControlMesh control;
  mesh::Vertices vertices_mm;
  mesh::TextureCoordinates projected_px;
  std::vector<std::uint8_t> facing;
};

/// columns x rows quads in the plane z = 0, spacing_mm apart; projects orthographically, 1 px per mm.
Surface plane(int columns, int rows, float spacing_mm);

/// A cube of cells x cells quads per side blown up to a sphere: closed, eight irregular vertices of valence
/// 3. Projects orthographically onto x and y, 1 px per mm; faces the camera where z > 0.
Surface sphere(int cells, float radius_mm);

/// A tube round the z axis, open at both ends; projects onto x and y, 1 px per mm.
Surface tube(int around, int along, float radius_mm, float length_mm);

}  // namespace facet::test
