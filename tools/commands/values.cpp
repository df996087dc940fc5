// `facet values`: how far the avatars that the daemon's bridges move follow each of ARKit's values.

#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "avatar/value_tuning.hpp"
#include "daemon_options.hpp"
#include "facet/error.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using nlohmann::json;

struct ValuesOptions {
  std::string name;
  std::optional<double> gain;
  std::optional<double> dead_zone;
  std::optional<double> smoothing_ms;
  bool reset = false;
};

/// As [bridges.values] of the configuration has it.
void print_tuning(const std::string& name, const json& tuning) {
  tell("{} = {{ gain = {}, dead_zone = {}, smoothing_ms = {} }}\n", name, tuning["gain"].get<double>(),
       tuning["dead_zone"].get<double>(), tuning["smoothing_ms"].get<double>());
}

void list(const DaemonOptions& daemon) {
  const json bridges = call_daemon(daemon, "status")["bridges"];
  const json values = bridges.value("values", json::object());
  if (values.empty()) {
    tell("every value is sent as it comes\n");
  }
  for (const auto& [name, tuning] : values.items()) {
    print_tuning(name, tuning);
  }
}

void set(const DaemonOptions& daemon, const ValuesOptions& options) {
  json params = {{"name", options.name}};
  const auto give = [&params](const char* key, const std::optional<double>& number) {
    if (number) {
      params[key] = *number;
    }
  };
  give("gain", options.gain);
  give("dead_zone", options.dead_zone);
  give("smoothing_ms", options.smoothing_ms);
  const json now = call_daemon(daemon, "values.set", params);
  tell(
      "It is so until the daemon ends. To keep it: `facet mapping save`, or under [bridges.values] in the "
      "configuration:\n");
  print_tuning(now["name"], now);
}

}  // namespace

void add_values_command(Command program) {
  const Command command = program.subcommand(
      "values",
      "Show, and with a name set, how far avatars that the daemon moves follow each of ARKit's values");
  const auto daemon = add_daemon_options(command);
  const auto options = std::make_shared<ValuesOptions>();
  command.option("name", options->name,
                 "One of ARKit's (jawOpen, eyeBlinkLeft ...), or all: every one that is not named otherwise");
  command.option("--gain", options->gain, "The value times this, at most 1; 1: as it comes")
      .range(0.0, avatar::kMostGain)
      .needs("name");
  command
      .option("--dead-zone", options->dead_zone,
              "0 for values below this; the range above is stretched to 0 to 1")
      .range(0.0, avatar::kMostDeadZone)
      .needs("name");
  command
      .option("--smoothing-ms", options->smoothing_ms,
              "Time constant: later by so much, and steadier; 0: none")
      .range(0.0, avatar::kMostValueSmoothing_ms)
      .needs("name");
  command.flag("--reset", options->reset, "Go back to what the configuration says, for all of them")
      .excludes("name");
  command.callback([daemon, options] {
    if (options->reset) {
      call_daemon(*daemon, "values.reset");
    } else if (options->name.empty()) {
      list(*daemon);
    } else {
      set(*daemon, *options);
    }
  });
}

}  // namespace facet::tools
