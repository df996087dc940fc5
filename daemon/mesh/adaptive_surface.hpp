#pragma once

#include <Eigen/SparseCore>
#include <cstdint>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::mesh {

/// One triangle of a 4-8 mesh. Two faces of one level that share their interior edge are mates and form a
/// block (a quad split along that edge); on the boundary a face may have no mate.
struct Face {
  std::int32_t apex = 0;   ///< the vertex opposite the interior edge; faces are (apex, start, end)
  std::int32_t start = 0;  ///< the interior edge, counter-clockwise
  std::int32_t end = 0;
  std::int32_t level = 0;  ///< bisections since the control mesh
};

/// A 4-8 mesh under construction: [MD19 alg. 1] in sweeps. It holds topology and the few
/// values per vertex that steer it; positions live outside and follow through the stencils that each sweep
/// returns. Start-up only (allocates); one thread.
class AdaptiveSurface {
 public:
  /// Row r, column c: how much of the old vertex c is in the new vertex r. Rows sum to 1.
  using Stencils = Eigen::SparseMatrix<double, Eigen::RowMajor>;

  /// Splits every quad (a, b, c, d) along a-c, level 0. projected_px [2][vertex_count], NaN where unknown;
  /// may_refine [vertex_count] 0 where only conformity may subdivide. Throws Error(UnreadableInput) where the
  /// quads are not an oriented manifold, with or without boundary, that uses every vertex.
  AdaptiveSurface(const Quads& quads, Eigen::Matrix2Xf projected_px, std::vector<std::uint8_t> may_refine);

  /// Bisects every face, whatever its size or flags.
  Stencils bisect_all();

  /// Bisects every face whose three vertices may be refined and whose interior edge projects to more than
  /// min_edge_px ([MD19 alg. 1], line 4), after whatever conformity demands (lines 5 to 9). Every face is
  /// processed at most once. The result has as many rows as columns where nothing was left to bisect.
  Stencils bisect_larger_than(float min_edge_px);

  std::int32_t vertex_count() const { return static_cast<std::int32_t>(may_refine_.size()); }
  /// Columns are (apex, start, end): the interior edge is the one between rows 1 and 2.
  Triangles triangles() const;

 private:
  bool wants_bisection(const Face& face, float min_edge_px) const;
  /// Marks every coarser face that must be bisected before the marked ones ([MD19 alg. 1], lines 5 to 9).
  void close_marks(std::vector<std::uint8_t>& marked) const;
  Stencils bisect_marked(std::vector<std::uint8_t> marked);
  /// Bisects the marked faces of one level and takes their marks away.
  Stencils bisect_level(std::int32_t level, std::vector<std::uint8_t>& marked);
  void group_faces_by_vertex();
  /// The mate of a face: the other face at its interior edge where that is of the same level, else -1.
  std::int32_t mate_of(std::int32_t face) const;
  void add_vertex_mask(std::int32_t vertex, std::vector<Eigen::Triplet<double>>& entries) const;
  void push_projections(const Stencils& stencils);

  std::vector<Face> faces_;
  Eigen::Matrix2Xf projected_px_;
  std::vector<std::uint8_t> may_refine_;
  std::vector<std::uint8_t> on_boundary_;
  std::vector<std::int32_t> smoothed_level_;  ///< last level whose vertex mask was applied; -1: none
  std::vector<std::int32_t> face_offsets_;    ///< [vertex_count + 1] into faces_of_vertex_
  std::vector<std::int32_t> faces_of_vertex_;
};

}  // namespace facet::mesh
