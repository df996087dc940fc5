#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

namespace facet::avatar {

/// A GLB file (glTF 2.0) in memory. The functions below understand its lists of buffers, buffer views and
/// accessors; whatever else the document holds is kept and written again as it was.
struct GlbDocument {
  nlohmann::ordered_json json;    ///< the document, names in the file's order
  std::vector<std::byte> binary;  ///< the first buffer
};

/// A larger GLB is refused, bytes.
inline constexpr std::size_t kMostGlbBytes = std::size_t{1} << 30;

/// Trusts nothing in the bytes. Throws Error(UnreadableInput) naming `source` and what is wrong.
GlbDocument parse_glb(std::span<const std::byte> bytes, const std::string& source);
/// Throws Error(UnreadableInput) naming the file.
GlbDocument read_glb(const std::filesystem::path& file);

/// Appends floats to the first buffer, which is made where there is none, and to the document a buffer view
/// and an accessor of them. Returns the accessor's index.
///
/// values  [count][numbers of one element]
/// type    glTF's name for an element: "SCALAR", "VEC4" ...
/// count   elements
/// extra   further members of the accessor
/// errors  Error(UnreadableInput) where "buffers", "bufferViews" or "accessors" of the document is no list
std::size_t append_floats(GlbDocument& glb, std::span<const float> values, const char* type,
                          std::size_t count, const nlohmann::ordered_json& extra);

/// Writes it whole or not at all. Throws Error(Storage) naming the file, Error(Usage) beyond 4 GiB,
/// Error(UnreadableInput) where a name in it is no UTF-8.
void write_glb(const GlbDocument& glb, const std::filesystem::path& file);

}  // namespace facet::avatar
