#include "trigger/gpio_trigger.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <set>
#include <utility>

#include "facet/error.hpp"
#include "trigger/gpio_lines.hpp"
#include "trigger/program.hpp"

namespace facet::trigger {
namespace {

/// `names` are those of the program's lines: each once, none unknown.
template <typename Wires>
void check_names(const TriggerProgram& program, const Wires& wires, const char* what) {
  std::set<std::string> seen;
  for (const auto& wire : wires) {
    if (std::none_of(program.lines.begin(), program.lines.end(),
                     [&](const TriggerLine& line) { return line.name == wire.name; })) {
      throw Error(ErrorKind::Usage,
                  fmt::format("{} of '{}': the trigger program has no such line", what, wire.name));
    }
    if (!seen.insert(wire.name).second) {
      throw Error(ErrorKind::Usage, fmt::format("line '{}' has two {}s", wire.name, what));
    }
  }
}

}  // namespace

std::unique_ptr<Trigger> open_gpio_trigger(const TriggerProgram& program, const GpioTriggerConfig& config) {
  check(program);
  check_names(program, config.outputs, "output");
  check_names(program, config.read_backs, "read-back");
  for (const TriggerLine& line : program.lines) {
    if (std::none_of(config.outputs.begin(), config.outputs.end(),
                     [&](const GpioOutput& output) { return output.name == line.name; })) {
      throw Error(ErrorKind::Usage, fmt::format("line '{}' has no GPIO output", line.name));
    }
  }
  return make_threaded_trigger(program, open_gpio_lines(program, config), config.thread);
}

}  // namespace facet::trigger
