// `facet takes`: the takes in the daemon's folder.

#include <fmt/format.h>

#include <cstdio>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "daemon_options.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using nlohmann::json;

void print(const json& list) {
  tell("{} takes in {}\n", list["count"].get<std::size_t>(), list["folder"].get<std::string>());
  if (list["takes"].empty()) {
    return;
  }
  tell("{:<32} {:<21} {:>8} {:>8} {:>9} {:>9}\n", "name", "recorded (UTC)", "frames", "meshes", "seconds",
       "MB");
  for (const json& take : list["takes"]) {
    const std::string name = take["name"];
    if (take.contains("error")) {
      tell("{:<32} {}\n", name, take["error"].get<std::string>());
      continue;
    }
    const std::string end_reason = take["end_reason"];
    tell("{:<32} {:<21} {:>8} {:>8} {:>9.1f} {:>9.1f}{}\n", name, take["created_utc"].get<std::string>(),
         take["frames"].get<std::int64_t>(), take["mesh_frames"].get<std::int64_t>(),
         take["duration_s"].get<double>(), take["bytes"].get<double>() / 1e6,
         !end_reason.empty()           ? "  ended: " + end_reason
         : !take["closed"].get<bool>() ? "  not closed"
                                       : "");
  }
  if (list["count"].get<std::size_t>() > list["takes"].size()) {
    tell("(the newest {} are shown)\n", list["takes"].size());
  }
}

}  // namespace

void add_takes_command(Command app) {
  const Command command = app.subcommand("takes", "List the takes in the daemon's folder, newest first");
  const auto options = add_daemon_options(command);
  const auto as_json = std::make_shared<bool>(false);
  command.flag("--json", *as_json, "Print the daemon's answer as JSON");
  command.callback([options, as_json] {
    const json list = call_daemon(*options, "takes.list", json::object());
    if (*as_json) {
      std::puts(list.dump(2, ' ', true).c_str());
    } else {
      print(list);
    }
  });
}

}  // namespace facet::tools
