#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

#include "capture/rig.hpp"

namespace facet::capture {

inline constexpr std::size_t kMaxRigFileBytes = 1U << 20;

/// Reads a rig from a TOML file (docs/rig-format.md). Throws Error(UnreadableInput) where the file can't be
/// read; Error(Usage) naming file, line and key, and what is allowed there. Any thread.
Rig read_rig(const std::filesystem::path& file);

/// The same from its text; `file` stands in messages alone.
Rig parse_rig(std::string_view text, const std::filesystem::path& file);

/// The text of a rig's file: parse_rig gives back the same rig, every number exactly.
std::string format_rig(const Rig& rig);

/// Writes a rig whole: an earlier file of the name stays until the new one is complete. Throws Error(Usage)
/// where the rig is none that read_rig would take, Error(Storage) where the file can't be written.
void write_rig(const Rig& rig, const std::filesystem::path& file);

}  // namespace facet::capture
