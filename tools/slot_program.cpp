#include "slot_program.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <sstream>

#include "facet/error.hpp"

namespace facet::tools {

std::vector<std::uint8_t> parse_slot_program(const std::string& text) {
  std::vector<std::uint8_t> program;
  std::istringstream words(text);
  for (std::string word; std::getline(words, word, ',');) {
    const auto first = word.find_first_not_of(' ');
    word = first == std::string::npos ? "" : word.substr(first, word.find_last_not_of(' ') + 1 - first);
    if (word.empty()) {
      program.clear();
      break;
    }
    program.push_back(word == "blank" ? 0 : 1);
  }
  const auto lit = std::count(program.begin(), program.end(), std::uint8_t{1});
  if (lit == 0 || lit == std::ssize(program)) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("--program {}: name what each slot shows, such as stripes,stripes,blank, with one "
                    "blank slot at least and one that is not",
                    text));
  }
  return program;
}

ProgramStart find_program_start(const std::vector<double>& unevenness,
                                const std::vector<std::uint8_t>& program) {
  /// A start counts where its blank slots are this much more even than those of every other start.
  constexpr double kClearly = 0.85;
  ProgramStart best;
  best.even = std::numeric_limits<double>::infinity();
  double second = std::numeric_limits<double>::infinity();
  for (std::size_t first = 0; first < program.size(); ++first) {
    double sums[2] = {0, 0};
    double counts[2] = {0, 0};
    for (std::size_t slot = 0; slot < unevenness.size(); ++slot) {
      if (unevenness[slot] > 0) {
        const std::uint8_t lit = program[(slot + first) % program.size()];
        sums[lit] += unevenness[slot];
        counts[lit] += 1;
      }
    }
    if (counts[0] == 0 || counts[1] == 0) {
      return {};
    }
    const double even = (sums[0] / counts[0]) / (sums[1] / counts[1]);
    second = std::min(second, std::max(even, best.even));
    if (even < best.even) {
      best = {first, even, false};
    }
  }
  best.told = best.even < kClearly && best.even < kClearly * second;
  return best;
}

}  // namespace facet::tools
