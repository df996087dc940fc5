#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::mesh {

/// One level of the 4-8 hierarchy [MD19 sec. 3; VZ01].
struct Level {
  std::int32_t vertex_count = 0;
  /// Columns are (apex, start, end): rows 1 and 2 are the interior edge, the one that a bisection would
  /// split.
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

/// Hierarchy::id of what a hierarchy holds. 15 ms for 200,000 vertices; any thread.
std::uint64_t topology_id(const Hierarchy& hierarchy);

/// Whether two hierarchies are one: id, counts, triangles and stencils. What comes from a file or a stream is
/// compared with this and not by its id alone, which it states itself. At once where they are one object; any
/// thread.
bool same_topology(const Hierarchy& a, const Hierarchy& b);

struct HierarchyOptions {
  /// Epsilon of [MD19 alg. 1]: a block whose interior edge projects to fewer px stays whole.
  float min_edge_px = 2.0F;
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

/// Builds the adaptive 4-8 hierarchy of [MD19 alg. 1]. Level 0 is one bisection sweep of every quad (made
/// whatever the bounds say); each further level is two adaptive sweeps, the last one possibly a single sweep,
/// until no block passes the test or an option's bound is met. Sweeps that add less than a tenth of the
/// vertices are folded into the level below (above level 0), so that every level is worth its solve.
///
/// Masks, the same for positions, displacements, albedo and texture coordinates:
/// * face mask: the vertex that splits an interior edge is 1/4 of each of the block's four corners;
/// * vertex mask: each corner of a bisected block becomes 1/2 of itself and 1/8 of each of the four vertices
///   that the blocks' edges join it to, once per subdivision level. ([MD19 alg. 1] spells this out for the
///   ends of the interior edge; the box spline that [VZ01] generalises moves the other two as well.)
/// * irregular inner vertices, where n blocks meet: 1/2 of itself and 1/(2 n) of each of those n vertices;
/// * boundary: its vertices stay, and an edge of it is split at its mid-point, so the open edges keep their
///   curve exactly.
/// A face is subdivided where its three vertices are refinable and facing and its interior edge projects to
/// more than min_edge_px. Before that, every coarser face at the ends of the interior edge, the mate among
/// them, is bisected, whatever its flags: the mesh stays conforming.
///
/// control_px  [2][control vertex_count] projections in the first good frame, px; NaN where behind the camera
///             (counts as not facing)
/// facing      [control vertex_count] 1 where the vertex faces the camera in that frame
/// errors      Error(UnreadableInput) naming the quad, edge or vertex where the control mesh is not an
///             oriented manifold (with or without boundary) that uses every vertex, or where an array's
///             length is not vertex_count; Error(Usage) where the options make no sense
/// Start-up only (allocates; 0.1 to 0.4 s for 100,000 vertices); any thread.
std::shared_ptr<const Hierarchy> build_hierarchy(const ControlMesh& control,
                                                 const TextureCoordinates& control_px,
                                                 const std::vector<std::uint8_t>& facing,
                                                 const HierarchyOptions& options);

/// A hierarchy below a mesh that is itself the control mesh refined in whole sweeps: that mesh's vertices are
/// the control vertices and level 0 (each its own stencil); level 1 is `sweeps` further sweeps of the blocks
/// whose three vertices come from refinable ones (ControlMesh::refinable; facing and projections play no
/// part). Masks and numbering as above.
///
/// coarse_vertex_count  of the mesh after as many whole sweeps as it takes, at least one
/// errors               Error(UnreadableInput) as above; Error(Usage) where no number of whole sweeps gives
///                      coarse_vertex_count or sweeps is below 1
/// Start-up only; any thread.
std::shared_ptr<const Hierarchy> build_hierarchy_below(const ControlMesh& control,
                                                       std::int32_t coarse_vertex_count, int sweeps);

/// Pushes control positions through the stencils to every level: out[l] is [3][levels[l].vertex_count].
/// Allocates on the first call only; any thread.
void push_positions(const Hierarchy& hierarchy, const Vertices& control, std::vector<Vertices>& out);

/// The refined mesh at the finest level: vertex + displacement * unit coarse normal [MD19 sec. 4.3],
/// and its unit normals. For consumers of the stream and of takes; allocates scratch. The same
/// bits whatever the compiler, and the same as libfacet-client's (clients/c/rebuild.c): change both together.
///
/// control_mm        [3][control_vertex_count]
/// displacements_mm  [finest vertex_count]; empty = 0
/// vertices_mm       [3][finest vertex_count] out
/// normals           [3][finest vertex_count] out
void rebuild_finest(const Hierarchy& hierarchy, const Vertices& control_mm,
                    const std::vector<float>& displacements_mm, Vertices& vertices_mm,
                    Eigen::Matrix3Xf& normals);

}  // namespace facet::mesh
