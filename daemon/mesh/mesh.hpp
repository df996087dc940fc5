#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace facet::mesh {

/// Vertex positions, one column per vertex: memory order x y z x y z ... Units are in the variable's name.
using Vertices = Eigen::Matrix3Xf;
/// Vertex indices of triangles, one column per triangle, counter-clockwise seen from outside.
using Triangles = Eigen::Matrix<std::int32_t, 3, Eigen::Dynamic>;
/// Vertex indices of quads, one column per quad, counter-clockwise seen from outside.
using Quads = Eigen::Matrix<std::int32_t, 4, Eigen::Dynamic>;
/// One column of texture coordinates per vertex, u right and v up, 0 to 1.
using TextureCoordinates = Eigen::Matrix2Xf;

/// Sparse rows in compressed form: row r holds entries [row_offsets[r], row_offsets[r + 1]) of columns and
/// weights.
struct SparseRows {
  std::vector<std::int32_t> row_offsets;  ///< [row_count + 1]
  std::vector<std::int32_t> columns;      ///< [entry_count]
  std::vector<float> weights;             ///< [entry_count]

  std::int32_t row_count() const {
    return row_offsets.empty() ? 0 : static_cast<std::int32_t>(row_offsets.size()) - 1;
  }
};

/// Neighbours of every vertex. For an inner vertex the ring is in counter-clockwise order and closed:
/// triangle k is (vertex, ring[k], ring[(k + 1) % valence]). For a boundary vertex it is open and runs from
/// one boundary edge to the other: triangle k is (vertex, ring[k], ring[k + 1]), one fewer than neighbours.
struct OneRings {
  std::vector<std::int32_t> offsets;      ///< [vertex_count + 1]
  std::vector<std::int32_t> neighbours;   ///< [sum of valences]
  std::vector<std::uint8_t> on_boundary;  ///< [vertex_count] 0 or 1
};

/// Builds the one-rings of a manifold triangle mesh with or without boundary.
/// Throws Error(UnreadableInput) naming the vertex, edge or triangle where the mesh is not manifold or not
/// consistently oriented, where a vertex belongs to no triangle, or where an index is out of range. Rings of
/// inner vertices start at an arbitrary but reproducible neighbour. Any thread; allocates.
OneRings build_one_rings(const Triangles& triangles, std::int32_t vertex_count);

/// Area-weighted unit vertex normals (the sum of [MD19 eq. 5] at d = 0); a vertex without area gets
/// (0, 0, 0). vertices [3][vertex_count]; triangles [3][triangle_count]; normals is resized to
/// [3][vertex_count].
void vertex_normals(const Vertices& vertices, const Triangles& triangles, Eigen::Matrix3Xf& normals);

/// out[:, r] = sum of weights * in[:, column] over row r, for any number of rows per column of `in`
/// (positions, albedo, texture coordinates or scalars). out is resized only when its size differs.
void apply(const SparseRows& stencils, const Eigen::Ref<const Eigen::MatrixXf>& in, Eigen::MatrixXf& out);
/// The same for positions.
void apply(const SparseRows& stencils, const Vertices& in, Vertices& out);

}  // namespace facet::mesh
