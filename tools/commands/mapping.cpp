// `facet mapping`: the formulas of a running daemon's bridges, changed from the next frame on, and saved.

#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "avatar/mapping_file.hpp"
#include "daemon_options.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using nlohmann::json;

struct MappingOptions {
  std::string table;
  std::string name;
  std::string formula;
  bool asked = false;  ///< a subcommand was: the parent's callback runs after it
};

void list(const DaemonOptions& daemon) {
  const json mapping = call_daemon(daemon, "mapping.get");
  const json values = call_daemon(daemon, "mapping.values");
  bool any = false;
  for (const avatar::MappingTable& table : avatar::kMappingTables) {
    for (const json& row : mapping[table.name]) {
      const std::string name = row["name"];
      tell("{:<12} {:<24} {:>6.3f}  {}\n", table.name, name, values[table.name].value(name, 0.0),
           row["formula"].get<std::string>());
      any = true;
    }
  }
  if (!any) {
    tell("nothing is mapped\n");
  }
  if (!mapping["saved"].get<bool>()) {
    tell("not saved: `facet mapping save` keeps it, and what `facet values` set\n");
  }
}

void add_place(const Command& command, MappingOptions& options) {
  std::vector<std::string> tables;
  tables.reserve(avatar::kMappingTables.size());
  for (const avatar::MappingTable& table : avatar::kMappingTables) {
    tables.emplace_back(table.name);
  }
  command.option("table", options.table, "Of which receivers").required().one_of(tables);
  command
      .option("name", options.name,
              "Of a value of VMC's, an avatar parameter of VRChat's, a tracking parameter of VTube Studio's")
      .required();
}

}  // namespace

void add_mapping_command(Command program) {
  const Command command =
      program.subcommand("mapping", "Show and change the formulas that the daemon sends to avatars, live");
  const auto daemon = add_daemon_options(command);
  const auto options = std::make_shared<MappingOptions>();
  const auto add = [&](const char* name, const char* help) {
    const Command added = command.subcommand(name, help);
    return std::pair(added, add_daemon_options(added));
  };
  const auto call = [options](const DaemonOptions& asked, const char* method, const json& params) {
    options->asked = true;
    return call_daemon(asked, method, params);
  };
  const auto [set, set_daemon] = add("set", "Send a name by a formula, from the next frame on");
  add_place(set, *options);
  set.option("formula", options->formula, "Of ARKit's values: \"0.8 * jawOpen + 0.2 * mouthFunnel\"")
      .required();
  set.callback([options, call, on = set_daemon] {
    call(*on, "mapping.set",
         {{"table", options->table}, {"name", options->name}, {"formula", options->formula}});
  });
  const auto [unset, unset_daemon] = add("unset", "Send a name no more, or as it is sent anyway");
  add_place(unset, *options);
  unset.callback([options, call, on = unset_daemon] {
    call(*on, "mapping.unset", {{"table", options->table}, {"name", options->name}});
  });
  const auto [save, save_daemon] = add(
      "save", "Write the formulas, and how far values are followed, to the file that bridges.mapping names");
  save.callback([call, on = save_daemon] {
    const json answer = call(*on, "mapping.save", json::object());
    tell("{}\n", answer["file"].get<std::string>());
  });
  const auto [reset, reset_daemon] = add("reset", "Go back to the formulas that were read or saved last");
  reset.callback([call, on = reset_daemon] { call(*on, "mapping.reset", json::object()); });
  command.callback([daemon, options] {
    if (!options->asked) {
      list(*daemon);
    }
  });
}

}  // namespace facet::tools
