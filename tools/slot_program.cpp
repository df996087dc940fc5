#include "slot_program.hpp"

#include <algorithm>
#include <iterator>
#include <limits>
#include <string>
#include <utility>

namespace facet::tools {

ProgramStart find_program_start(const std::vector<double>& unevenness, const capture::SlotProgram& program) {
  /// A start counts where its blank slots are this much more even than in every other start.
  constexpr double kClearly = 0.85;
  ProgramStart best;
  best.even = std::numeric_limits<double>::infinity();
  double second = std::numeric_limits<double>::infinity();
  const auto like_an_earlier_one = [&](std::size_t first) {
    const auto alike = [&](std::size_t other) {
      for (std::size_t slot = 0; slot < program.size(); ++slot) {
        if (capture::light_of_slot(program, slot + first).has_pattern() !=
            capture::light_of_slot(program, slot + other).has_pattern()) {
          return false;
        }
      }
      return true;
    };
    for (std::size_t other = 0; other < first; ++other) {
      if (alike(other)) {
        return true;
      }
    }
    return false;
  };
  for (std::size_t first = 0; first < program.size(); ++first) {
    if (like_an_earlier_one(first)) {
      continue;  // fringes by half a period more are the same to a pair
    }
    double sums[2] = {0, 0};
    double counts[2] = {0, 0};
    for (std::size_t slot = 0; slot < unevenness.size(); ++slot) {
      if (unevenness[slot] > 0) {
        const bool striped = capture::light_of_slot(program, slot + first).has_pattern();
        sums[striped ? 1 : 0] += unevenness[slot];
        counts[striped ? 1 : 0] += 1;
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

std::optional<capture::SlotProgram> recorded_program(take::TakeReader& take,
                                                     const std::vector<std::int64_t>& slots) {
  constexpr std::size_t kLookedAt = 64;
  std::vector<std::pair<std::uint64_t, std::string>> words;
  for (std::size_t i = 0; i < std::min(slots.size(), kLookedAt); ++i) {
    const auto frame = take.frame(slots[i], take::Pictures::Described);
    if (frame->images == nullptr || frame->images->light.empty()) {
      return {};
    }
    if (!capture::read_slot_light(frame->images->light)) {
      return {};
    }
    words.emplace_back(frame->sequence, frame->images->light);
  }
  for (std::size_t period = 2; 2 * period <= words.size(); ++period) {
    std::vector<std::string> program(period);
    const bool follows = std::all_of(words.begin(), words.end(), [&](const auto& slot) {
      std::string& word = program[slot.first % period];
      word = word.empty() ? slot.second : word;
      return word == slot.second;
    });
    if (follows && std::find(program.begin(), program.end(), std::string()) == program.end()) {
      capture::SlotProgram found;
      std::transform(program.begin(), program.end(), std::back_inserter(found), capture::parse_slot_light);
      return capture::makes_meshes(found) ? std::optional(found) : std::nullopt;
    }
  }
  return {};
}

}  // namespace facet::tools
