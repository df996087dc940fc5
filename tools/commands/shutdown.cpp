// `facet shutdown`: ends the running daemon; a take that is being recorded is closed.

#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "daemon_options.hpp"

namespace facet::tools {

void add_shutdown_command(Command app) {
  const Command command = app.subcommand("shutdown", "End the running daemon; a take in progress is closed");
  const auto options = add_daemon_options(command);
  command.callback([options] { call_daemon(*options, "shutdown", nlohmann::json::object()); });
}

}  // namespace facet::tools
