#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "mesh/mesh.hpp"

namespace facet::simulation {

/// The true surface of one frame. Camera frame: x right, y down, z forward; mm.
struct TruthMesh {
  mesh::Vertices vertices_mm;  ///< [3][vertex_count]
  Eigen::Matrix3Xf normals;    ///< [3][vertex_count] unit
  Eigen::Matrix3Xf albedo;     ///< [3][vertex_count] linear RGB 0 to 1
  mesh::Triangles triangles;   ///< [3][triangle_count]
};

/// Writes binary little-endian PLY: x y z nx ny nz as float, albedo_red/green/blue as float (linear), red
/// green blue as uchar (the albedo in sRGB, for viewers), faces as triangles. Through a temporary name.
/// frame: what the positions are, for the file's comment.
/// Throws Error(Storage).
void write_truth_ply(const TruthMesh& mesh, const std::filesystem::path& file,
                     std::string_view frame = "camera frame, mm, x right, y down, z forward");

/// Reads any PLY that files::parse_ply reads with x y z and faces. Normals are brought to length 1; where the
/// file lacks them, or one of them, they are computed from the faces. Missing albedo is grey.
/// Throws Error(UnreadableInput) naming the file and what is wrong.
TruthMesh read_truth_ply(const std::filesystem::path& file);

/// The same from memory; source names it in messages.
TruthMesh parse_truth_ply(std::span<const std::byte> bytes, const std::string& source);

}  // namespace facet::simulation
