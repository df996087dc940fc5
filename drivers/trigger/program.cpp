#include "trigger/program.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "facet/error.hpp"

namespace facet::trigger {
namespace {

[[noreturn]] void refuse(const std::string& what) {
  throw Error(ErrorKind::Usage, "trigger program: " + what);
}

template <typename Wanted>
LineMask mask_where(const TriggerProgram& program, Wanted wanted) {
  LineMask mask = 0;
  for (std::size_t i = 0; i < program.lines.size(); ++i) {
    mask |= wanted(program.lines[i]) ? LineMask{1} << i : 0;
  }
  return mask;
}

void check_line(const TriggerLine& line, std::int64_t exposure_ns) {
  // Names stand in logs as one word.
  if (line.name.empty() || line.name.size() > 64 ||
      std::any_of(line.name.begin(), line.name.end(), [](char c) { return c <= ' ' || c > '~'; })) {
    refuse(fmt::format("'{}' is no line name: 1 to 64 visible characters without blanks", line.name));
  }
  if (line.role == LineRole::Camera && line.safe_active) {
    refuse(fmt::format("camera line '{}' can't rest active; use active_low where the wire rests high",
                       line.name));
  }
  if (line.pulse_ns < 0 || line.pulse_ns > exposure_ns) {
    refuse(fmt::format("the pulse of line '{}' ({} us) must lie between 0 and the exposure ({} us)",
                       line.name, line.pulse_ns / 1000, exposure_ns / 1000));
  }
  if (line.role == LineRole::Projector && line.pulse_ns != 0) {
    refuse(fmt::format("projector line '{}' holds for the whole exposure and has no pulse", line.name));
  }
}

}  // namespace

LineMask lines_of(const TriggerProgram& program, LineRole role) {
  return mask_where(program, [role](const TriggerLine& line) { return line.role == role; });
}

LineMask safe_lines(const TriggerProgram& program) {
  return mask_where(program, [](const TriggerLine& line) { return line.safe_active; });
}

void check(const TriggerProgram& program) {
  if (program.lines.empty() || program.lines.size() > kMaxTriggerLines) {
    refuse(fmt::format("needs 1 to {} lines, has {}", kMaxTriggerLines, program.lines.size()));
  }
  if (!(program.slots_per_second >= 1 && program.slots_per_second <= 1000)) {
    refuse(fmt::format("{} slots per second; 1 to 1000 are possible", program.slots_per_second));
  }
  const auto period_ns = static_cast<std::int64_t>(1e9 / program.slots_per_second);
  for (const std::int64_t part_ns : {program.settle_ns, program.exposure_ns, program.tolerance_ns}) {
    if (part_ns < 0 || part_ns > period_ns) {
      refuse(fmt::format("settle time, exposure and tolerance must lie between 0 and a slot ({} us)",
                         period_ns / 1000));
    }
  }
  if (program.exposure_ns == 0 || program.tolerance_ns == 0) {
    refuse("exposure and tolerance must not be 0");
  }
  if (program.settle_ns + program.exposure_ns + program.tolerance_ns > period_ns) {
    refuse(fmt::format("settle time {} us + exposure {} us + tolerance {} us do not fit into a slot of {} us",
                       program.settle_ns / 1000, program.exposure_ns / 1000, program.tolerance_ns / 1000,
                       period_ns / 1000));
  }
  std::set<std::string> names;
  for (const TriggerLine& line : program.lines) {
    check_line(line, program.exposure_ns);
    if (!names.insert(line.name).second) {
      refuse(fmt::format("two lines are named '{}'", line.name));
    }
  }
  if (lines_of(program, LineRole::Camera) == 0) {
    refuse("there is no camera line");
  }
  if (program.patterns.empty()) {
    refuse("there is no pattern; one pattern without lines is a blank slot");
  }
  const LineMask projectors = lines_of(program, LineRole::Projector);
  for (std::size_t i = 0; i < program.patterns.size(); ++i) {
    if ((program.patterns[i] & ~projectors) != 0) {
      refuse(fmt::format("pattern {} names a line that is no projector's", i));
    }
  }
}

}  // namespace facet::trigger
