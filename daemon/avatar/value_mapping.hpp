#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "avatar/formula.hpp"

namespace facet::avatar {

/// A number that is sent under a name of its own.
struct MappedValue {
  std::string name;
  Formula formula;
};
using MappedValues = std::vector<MappedValue>;

/// What a receiver gets beside, or in the place of, the names that are sent to all.
struct ValueMapping {
  MappedValues vmc;     ///< names of /VMC/Ext/Blend/Val
  MappedValues vrchat;  ///< names of avatar parameters, without "/avatar/parameters/"
};

inline constexpr std::size_t kMostMappingBytes = 1U << 16;
inline constexpr std::size_t kMostMappedValues = 256;  ///< of a table
inline constexpr std::size_t kMostMappedNameBytes = 64;

/// Reads the tables [vmc] and [vrchat] of `name = "formula"` (docs/bridges.md). file: for messages. Throws
/// Error(Usage) that names file, line and key.
ValueMapping parse_mapping(std::string_view text, const std::filesystem::path& file);
/// Throws Error as well where the file can't be read. An empty path is an empty mapping.
ValueMapping load_mapping(const std::filesystem::path& file);

/// A value in the program's own text.
struct NamedFormula {
  const char* name;
  const char* formula;
};
MappedValues mapped_values(std::span<const NamedFormula> named);

/// Of a table that is sent to all, those whose name `chosen` does not have, and `chosen` behind them.
MappedValues replaced(MappedValues all, const MappedValues& chosen);

}  // namespace facet::avatar
