#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "avatar/formula.hpp"
#include "avatar/value_tuning.hpp"

namespace facet::avatar {

/// A number that is sent under a name of its own.
struct MappedValue {
  std::string name;
  Formula formula;

  bool operator==(const MappedValue&) const = default;
};
using MappedValues = std::vector<MappedValue>;

/// What a receiver gets beside, or in the place of, the names that are sent to all.
struct ValueMapping {
  MappedValues vmc;                      ///< names of /VMC/Ext/Blend/Val
  MappedValues vrchat;                   ///< names of avatar parameters, without "/avatar/parameters/"
  MappedValues vtube_studio;             ///< names of tracking parameters, VTube Studio's own or further ones
  std::optional<ValueTunings> values{};  ///< in the place of the configured ones

  bool operator==(const ValueMapping&) const = default;
};

/// A value in the program's own text.
struct NamedFormula {
  const char* name;
  const char* formula;
};
MappedValues mapped_values(std::span<const NamedFormula> named);

/// Of a table that is sent to all, those whose name `chosen` does not have, and `chosen` behind them.
MappedValues replaced(MappedValues all, const MappedValues& chosen);

}  // namespace facet::avatar
