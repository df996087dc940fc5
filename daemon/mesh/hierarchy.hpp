#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::mesh {

/// One level of the 4-8 hierarchy (Ma & Deng 2019, section 3; Velho & Zorin 2001).
struct Level {
  std::int32_t vertex_count = 0;
  Triangles triangles;
  /// Positions (and displacements, albedo, texture coordinates) of this level from the next coarser one; for
  /// level 0 from the control mesh. Row r is vertex r of this level; weights of a row sum to 1. Vertices of
  /// the coarser level keep their index, new ones are appended.
  SparseRows from_coarser;
  OneRings one_rings;
};

/// The fixed hierarchy of one subject: topology and stencils only; at run time positions move through the
/// stencils.
struct Hierarchy {
  std::uint64_t id = 0;                   ///< hash of the whole topology and all stencils; never 0
  std::int32_t control_vertex_count = 0;  ///< vertices of the face model's quad mesh
  std::vector<Level> levels;  ///< [0] is M0, the coarse mesh (one bisection sweep of the quads), then finer
  TextureCoordinates texture_coordinates;  ///< [2][finest vertex_count]

  const Level& finest() const { return levels.back(); }
};

struct HierarchyOptions {
  float min_edge_px =
      2.0F;  ///< epsilon of Algorithm 1: a block whose interior edge projects to fewer pixels stays whole
  int max_levels = 6;                   ///< level 0 counted
  std::int32_t max_vertices = 200'000;  ///< of the finest level; the sweep that would pass it is not made
};

/// Control mesh of quads with what the hierarchy needs of it.
struct ControlMesh {
  Quads quads;  ///< [4][quad_count]
  std::int32_t vertex_count = 0;
  TextureCoordinates texture_coordinates;  ///< [2][vertex_count]
  std::vector<std::uint8_t> refinable;  ///< [vertex_count] 0: never subdivided beyond what conformity needs
};

/// Builds the adaptive 4-8 hierarchy of Algorithm 1. Level 0 is one bisection sweep of every quad; each
/// further level is two adaptive sweeps, until no block passes the test or an option's bound is met.
///
/// control_px   [2][control vertex_count] projections in the first good frame, px; NaN where behind the
/// camera facing       [control vertex_count] 1 where the vertex faces the camera in that frame (others are
/// not subdivided) errors       Error(UnreadableInput) where the quads are not manifold Start-up only
/// (allocates); any thread.
std::shared_ptr<const Hierarchy> build_hierarchy(const ControlMesh& control,
                                                 const TextureCoordinates& control_px,
                                                 const std::vector<std::uint8_t>& facing,
                                                 const HierarchyOptions& options);

/// Pushes control positions through the stencils to every level: out[l] is [3][levels[l].vertex_count].
void push_positions(const Hierarchy& hierarchy, const Vertices& control, std::vector<Vertices>& out);

/// The refined mesh at the finest level: vertex + displacement * unit coarse normal (Ma & Deng 2019,
/// section 4.3), and its normals. control_mm [3][control_vertex_count]; displacements_mm [finest
/// vertex_count] (empty = 0); outputs resized as needed.
void rebuild_finest(const Hierarchy& hierarchy, const Vertices& control_mm,
                    const std::vector<float>& displacements_mm, Vertices& vertices_mm,
                    Eigen::Matrix3Xf& normals);

}  // namespace facet::mesh
