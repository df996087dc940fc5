#pragma once

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

namespace facet::avatar {

/// A GLB file (glTF 2.0) in memory: the document, of which only what is named here is understood and
/// everything else kept as it is, and the bytes of its first buffer.
struct GlbDocument {
  nlohmann::ordered_json json;
  std::vector<std::byte> binary;
};

/// A larger GLB is refused, bytes.
inline constexpr std::size_t kMostGlbBytes = std::size_t{1} << 30;

/// Trusts nothing in the bytes. Throws Error(UnreadableInput) naming `source` and what is wrong.
GlbDocument parse_glb(std::span<const std::byte> bytes, const std::string& source);
/// Throws Error(UnreadableInput) naming the file.
GlbDocument read_glb(const std::filesystem::path& file);

/// Appends an accessor of floats to the first buffer; returns its index. type: "SCALAR", "VEC4" ...; extra:
/// further members. Throws Error(UnreadableInput) where the document's lists are none.
std::size_t append_floats(GlbDocument& glb, std::span<const float> values, const char* type,
                          std::size_t count, const nlohmann::ordered_json& extra);

/// Writes it whole or not at all. Throws Error(Storage) naming the file, Error(Usage) beyond 4 GiB,
/// Error(UnreadableInput) where a name in it is no UTF-8.
void write_glb(const GlbDocument& glb, const std::filesystem::path& file);

}  // namespace facet::avatar
