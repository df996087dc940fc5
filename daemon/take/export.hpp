#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "mesh/mesh_frame.hpp"

namespace facet::take {

enum class MeshLevel { Coarse, Finest };
enum class MeshFormat { Ply, Obj, Glb };

/// Lower-case file name extension without dot.
const char* extension(MeshFormat format);

/// One frame as a mesh to write: camera frame, mm, x right, y down, z forward.
struct ExportMesh {
  mesh::Vertices vertices_mm;                    ///< [3][vertex_count]
  Eigen::Matrix3Xf normals;                      ///< [3][vertex_count] unit length
  mesh::Triangles triangles;                     ///< counter-clockwise from outside
  mesh::TextureCoordinates texture_coordinates;  ///< [2][vertex_count] u right, v up
  mesh::Vertices albedo;                         ///< [3][vertex_count] linear RGB; empty: not learned yet
  std::vector<float> displacements_mm;           ///< [vertex_count]; 0 at level Coarse or where not refined
  std::vector<float> confidence;                 ///< [vertex_count]; 0 where not refined
};

/// True where the frame has a mesh to export.
bool has_mesh(const mesh::MeshFrame& frame);

/// Builds the mesh of a frame that has one. Buffers in `out` are reused.
void build_export_mesh(const mesh::MeshFrame& frame, MeshLevel level, ExportMesh& out);

/// Writers. Each writes a temporary file beside `file` and renames it, so that no reader meets half a file
/// and an interrupted export leaves the earlier one. Throw Error(Storage) naming the file.
///
/// PLY: binary little-endian; x y z, nx ny nz, s t, red green blue (sRGB of the albedo; 200 200 200 before
/// it is learned), displacement_mm, confidence; camera frame, mm.
void write_ply(const ExportMesh& mesh, const std::filesystem::path& file);
/// OBJ: camera frame, mm; v with colour appended, vt, vn.
void write_obj(const ExportMesh& mesh, const std::filesystem::path& file);
/// GLB (glTF 2.0): the same frame turned y up (x, -y, -z), metres; NORMAL, TEXCOORD_0, COLOR_0 (linear
/// albedo), _DISPLACEMENT_MM, _CONFIDENCE.
void write_glb(const ExportMesh& mesh, const std::filesystem::path& file);
void write_mesh(MeshFormat format, const ExportMesh& mesh, const std::filesystem::path& file);

/// One line of the jsonl export, without the newline: index, sequence, timestamp_ns, media_time_ns, state,
/// degraded, camera, camera_from_head, expression, identity, lighting, landmarks_px, reprojection_px,
/// photometric_rms, stage_ms. Without a mesh camera_from_head is null and the lists are empty.
std::string frame_json(const mesh::MeshFrame& frame, std::int64_t index);

}  // namespace facet::take
