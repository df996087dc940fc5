#include "slot_program.hpp"

#include <algorithm>
#include <iterator>
#include <limits>
#include <string>
#include <utility>

namespace facet::tools {

namespace {

/// Whether a recording that begins with one slot of the program can't be told from one that begins with the
/// other: all lights are the same, but for a shift that all fringes have in common, which is nothing to
/// cameras.
bool are_alike(const capture::SlotProgram& program, std::size_t one, std::size_t other) {
  std::optional<int> further;
  for (std::size_t slot = 0; slot < program.size(); ++slot) {
    const capture::SlotLight& a = capture::light_of_slot(program, slot + one);
    const capture::SlotLight& b = capture::light_of_slot(program, slot + other);
    if (a.kind != b.kind || a.lights != b.lights) {
      return false;
    }
    const int shift = (b.quarters - a.quarters + 4) % 4;
    if (a.kind == capture::SlotLight::Kind::Fringes && further.value_or(shift) != shift) {
      return false;
    }
    further = a.kind == capture::SlotLight::Kind::Fringes ? shift : further;
  }
  return true;
}

}  // namespace

ProgramStart find_program_start(const std::vector<double>& unevenness, const capture::SlotProgram& program) {
  /// A start counts where its blank slots are this much more even than in every other start.
  constexpr double kClearly = 0.85;
  ProgramStart best;
  best.even = std::numeric_limits<double>::infinity();
  best.repeats_after = program.size();
  double second = std::numeric_limits<double>::infinity();
  for (std::size_t first = 0; first < program.size(); ++first) {
    if (first > 0 && best.repeats_after == program.size() && are_alike(program, 0, first)) {
      best.repeats_after = first;
    }
    if (first >= best.repeats_after) {
      break;
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
      best.first = first;
      best.even = even;
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
