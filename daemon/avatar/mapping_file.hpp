#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

#include "avatar/value_mapping.hpp"

namespace facet::files {
class TomlSection;
}

namespace facet::avatar {

inline constexpr std::size_t kMostMappingBytes = 1U << 16;
inline constexpr std::size_t kMostMappedValues = 256;  ///< of a table
inline constexpr std::size_t kMostMappedNameBytes = 64;

/// What the names of a table may be.
enum class MappedNames {
  Text,     ///< letters that can be shown
  Address,  ///< parts of an OSC address
  Word,     ///< 4 to 32 letters and digits
};

/// A table of a mapping file.
struct MappingTable {
  const char* name;
  MappedValues ValueMapping::*values;
  MappedNames names;
  float least;  ///< what comes out is cut to this
  float most;   ///< and this
};
inline constexpr std::array<MappingTable, 3> kMappingTables = {{
    {"vmc", &ValueMapping::vmc, MappedNames::Text, 0, 1},
    {"vrchat", &ValueMapping::vrchat, MappedNames::Address, -1, 1},
    {"vtube_studio", &ValueMapping::vtube_studio, MappedNames::Word, -1e6F, 1e6F},
}};

/// Why a name can't be sent, to follow on the name; empty where it can.
std::string name_fault(const MappingTable& table, std::string_view name);

/// Reads the tables of `name = "formula"` (kMappingTables), and [values] (docs/bridges.md). file: for
/// messages. Throws Error(Usage) that names file, line and key.
ValueMapping parse_mapping(std::string_view text, const std::filesystem::path& file);
/// An empty path is an empty mapping, and so is one where there is no file: there will be one once a mapping
/// is saved. Throws Error as well where the file can't be read.
ValueMapping load_mapping(const std::filesystem::path& file);

/// What parse_mapping() reads as the same mapping.
std::string mapping_text(const ValueMapping& mapping);
/// Writes mapping_text() in the place of an earlier file. Throws Error(Usage) where it is longer than a
/// mapping file may be, Error(Storage) naming the file where it can't be written.
void save_mapping(const ValueMapping& mapping, const std::filesystem::path& file);

/// Reads the table of tunings of a configuration or of a mapping file. A name that is there has nothing of
/// "all": what it leaves out is plain. Throws Error(Usage).
ValueTunings read_tunings(files::TomlSection section);

}  // namespace facet::avatar
