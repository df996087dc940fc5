#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace facet::files {

// A plain array: a call of a std::array's member would take the packed array for an aligned one.
#pragma pack(push, 1)
/// A triangle as it lies in the file.
struct PlyFace {
  std::uint8_t count;
  std::int32_t corners[3];
};
#pragma pack(pop)
static_assert(sizeof(PlyFace) == 13);

/// Triangles for write_ply; what it refers to outlives the call.
struct PlyMesh {
  std::vector<std::string> comments;    ///< one a line
  std::vector<std::string> fields;      ///< of a vertex, in their order: "float NAME" or "uchar NAME"
  std::span<const std::byte> vertices;  ///< packed, little-endian
  std::size_t vertex_count = 0;
  std::span<const std::int32_t> corners;  ///< [triangles][3]
};

/// Writes a PLY file, binary_little_endian, whole or not at all. Throws Error(Storage), and Error(Internal)
/// where sizes and fields don't agree.
void write_ply(const PlyMesh& mesh, const std::filesystem::path& file);

}  // namespace facet::files
