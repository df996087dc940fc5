#pragma once

#include <filesystem>
#include <string>

#include "take/reader.hpp"

namespace facet::take {

/// What close_take found and left.
struct ClosedTake {
  TakeInfo info;           ///< as the take is now
  bool recovered = false;  ///< it had been broken off and was closed now
  std::string left;  ///< empty where the take is closed and one file; else what is in the way, for people
};

/// Makes a take one closed file, where it is not and nobody has it open: the write-ahead log that a recorder
/// left beside it is folded in, and a recording that was broken off is marked as closed, with an `end_reason`
/// that says so. A take that is being recorded or read, by any process, stays as it is. Does not change what
/// is closed already. Blocks for half a second at most while the take is in use. Any thread. Throws as
/// TakeReader does.
ClosedTake close_take(const std::filesystem::path& file);

}  // namespace facet::take
