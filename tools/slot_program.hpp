#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace facet::tools {

/// What a booth's trigger shows slot after slot, again and again, as "stripes,stripes,blank" (any word but
/// "blank" is light with a pattern): 1 with stripes, 0 blank. Throws Error(Usage) unless there is one of
/// either.
std::vector<std::uint8_t> parse_slot_program(const std::string& text);

/// Which slot of the program a recording begins with, told by its pictures: blank ones are the even ones.
struct ProgramStart {
  std::size_t first = 0;  ///< index into the program of the recording's first slot
  double even = 0;        ///< unevenness of the blank slots then, as a share of that of the others
  bool told = false;      ///< false: no start fits clearly better than every other one
};
/// unevenness  [slot_count] of one camera's pictures, 0 or less where it has none
ProgramStart find_program_start(const std::vector<double>& unevenness,
                                const std::vector<std::uint8_t>& program);

}  // namespace facet::tools
