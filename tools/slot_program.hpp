#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "capture/slot_program.hpp"
#include "take/reader.hpp"

namespace facet::tools {

/// Which slot of the program a recording begins with, told by its pictures: those without a pattern are the
/// even ones.
struct ProgramStart {
  std::size_t first = 0;  ///< index into the program of the recording's first slot
  double even = 0;        ///< unevenness of the slots without a pattern, as a share of that of the others
  bool told = false;      ///< false: no start fits clearly better than every other one
  std::size_t repeats_after = 0;  ///< so many slots later a start can't be told from it
};
/// unevenness  [slot_count] of one camera's pictures, 0 or less where it has none
ProgramStart find_program_start(const std::vector<double>& unevenness, const capture::SlotProgram& program);

/// What the first slots of a take say of their light, as the shortest program that they follow; nothing where
/// one does not say it or they follow none. slots: their indices in the take.
std::optional<capture::SlotProgram> recorded_program(take::TakeReader& take,
                                                     const std::vector<std::int64_t>& slots);

}  // namespace facet::tools
