#pragma once

#include <cstdint>
#include <vector>

#include "gpu/device_array.hpp"
#include "mesh/hierarchy.hpp"
#include "refine/patches.hpp"

namespace facet::refine {

using gpu::clear;
using gpu::DeviceArray;

/// The one-rings of one level as shaders/refine/topology.glsl reads them, and its patches.
struct LevelTopology {
  /// free          [vertex_count] 1 where shading may move the vertex; boundary vertices never are
  /// curve         [vertex_count] vertices in the order in which patches are cut of them: DeviceOrder::curve
  /// trust         [vertex_count] 0 to 1, kept in 8 bits: SubjectSetup::trust. Empty: 1
  /// patch_vertices  of a patch at most; 0: DeviceInfo::patch_vertices
  LevelTopology(gpu::Context& context, const mesh::OneRings& rings, const std::vector<std::uint8_t>& free,
                const std::vector<std::int32_t>& curve, const std::vector<float>& trust = {},
                std::uint32_t patch_vertices = 0);

  std::uint32_t vertex_count;
  std::uint32_t group_count;      ///< groups of four ring entries
  std::uint32_t workgroup_count;  ///< that every kernel over this level's vertices runs with
  DeviceArray vertex_rings;
  DeviceArray ring_indices;  ///< each ring filled up to whole groups
  LevelPatches patches;
};

/// Rows of stencils from the next coarser level.
struct LevelStencils {
  LevelStencils(gpu::Context& context, const mesh::SparseRows& rows);

  DeviceArray stencil_rows;
  DeviceArray stencil_entries;
};

/// Values of a level's vertices. All 0 at first.
struct LevelState {
  LevelState(gpu::Context& context, std::uint32_t vertex_count);

  DeviceArray positions;   ///< shading frame, mm; displacement, mm
  DeviceArray normals;     ///< unit coarse normal; mean distance to the ring, mm
  DeviceArray colours;     ///< linear RGB as seen; weight 0 to 1
  DeviceArray albedo;      ///< linear RGB; confidence 0 to 1
  DeviceArray irradiance;  ///< of the room's lamps as the normal sees it: x + yzw . n (RoomLight)
  DeviceArray priors;      ///< displacement prolonged from the coarser level, mm
  /// Of a known relief r, mm: r, its L r (what it stands out of its ring's mean), what it has beyond the
  /// coarser level's.
  DeviceArray reliefs;
};

/// Which vertices of every level shading may move: those that come from refinable control vertices, and not
/// on the boundary. A vertex whose stencils draw less than three quarters from refinable ones is not. Returns
/// [level][vertex].
std::vector<std::vector<std::uint8_t>> free_vertices(const mesh::Hierarchy& hierarchy,
                                                     const std::vector<std::uint8_t>& refinable);

/// SubjectSetup::trust of the control vertices prolonged to every level: [level][vertex], empty where it is.
std::vector<std::vector<float>> trust_of_levels(const mesh::Hierarchy& hierarchy,
                                                const std::vector<float>& trust);

}  // namespace facet::refine
