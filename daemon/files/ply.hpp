#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
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

/// What a PLY file says of a surface.
struct PlySurface {
  std::size_t vertex_count = 0;
  std::vector<std::string> names;          ///< of the numbers of a vertex, as the file has them
  std::vector<std::vector<float>> values;  ///< [names][vertex_count]
  std::vector<std::int32_t> corners;       ///< [triangles][3]; a polygon is a fan about its first corner

  /// [vertex_count] of that name; null where the file has none.
  const std::vector<float>* find(std::string_view name) const;
};

/// Reads the vertices and faces of a PLY file: ascii, binary_little_endian or binary_big_endian; numbers of
/// any of its types, lists with counts and indices of any integer type; polygons of 3 corners and more.
/// Other elements, lists of vertices and other properties of faces are passed over. A file without an element
/// `face` has no corners. Names of corners are checked, values may be not finite.
///
/// source   names the bytes in messages
/// Throws Error(UnreadableInput) naming the source and what is wrong: not a PLY file, cut off, longer than
/// its header says, triangle strips, corners that are not there.
PlySurface parse_ply(std::span<const std::byte> bytes, const std::string& source);

}  // namespace facet::files
