#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string_view>
#include <vector>

#include "exports/export.hpp"
#include "files/output_file.hpp"

namespace facet::exports {

inline constexpr float kMetresPerMillimetre = 0.001F;

/// What a mesh in the camera frame is multiplied by, axis by axis: x right, y up, z towards the camera. Its
/// normals by the same.
inline Eigen::Vector3f upright_axes() {
  return {1.0F, -1.0F, -1.0F};
}
/// The same with the unit: what its vertices are multiplied by.
Eigen::Vector3f factors_of(MeshAxes axes);

/// write_obj without a change to any number. words: of frame and unit, in its first line
void write_obj_as_is(const ExportMesh& mesh, const std::filesystem::path& file, std::string_view words);

/// Makes normals unit length; those of vertices that no triangle holds, which no format allows to be 0, point
/// along -z.
void mend_normals(Eigen::Matrix3Xf& normals);

/// A mesh with the neutral face's vertices and normals in place of its own. mesh: at level Coarse.
ExportMesh neutral_mesh(const ExpressionShapes& shapes, const ExportMesh& mesh);

/// Throws Error(Usage) naming file and frame where a frame's mesh has other vertices or triangles than the
/// first's.
void require_same_mesh(const mesh::Triangles& triangles, const SequenceFrame& frame,
                       const std::filesystem::path& file);

/// x right, y up, z towards the viewer, metres, from the head frame in mm: rotation as it is, translation in
/// metres.
Eigen::Isometry3f metres_from_head(const SequenceFrame& frame);

/// What PC2 and MDD have in common: a mesh to put the cache on, written as OBJ beside it, and one sample for
/// every number of the source from first to last. Frames without a mesh are held from the one before.
class VertexCache {
 public:
  /// Writes nothing yet.
  VertexCache(const SequenceOptions& options, const SequenceFrame& first);

  std::int32_t point_count() const { return static_cast<std::int32_t>(base_.vertices_mm.cols()); }
  /// first to last of the timeline. Throws Error(Usage) beyond 2^31 samples.
  std::int32_t sample_count() const { return sample_count_; }

  /// Calls write(points) for every sample that is due now that the frame has come: [3][point_count] metres, y
  /// up.
  template <typename Write>
  void add(const SequenceFrame& frame, const Write& write) {
    require_same_mesh(base_.triangles, frame, options_.file);
    for (; points_.cols() > 0 && next_ < frame.sequence; ++next_) {
      write(points_);
    }
    place(frame);
    write(points_);
    next_ = frame.sequence + 1;
  }
  /// Puts the mesh and then the cache in their places.
  void commit(files::OutputFile& cache) const;

  const Timeline& timeline() const { return options_.timeline; }

 private:
  void place(const SequenceFrame& frame);

  SequenceOptions options_;
  ExportMesh base_;
  mesh::Vertices points_;
  std::uint64_t next_ = 0;
  std::int32_t sample_count_ = 0;
};

}  // namespace facet::exports
