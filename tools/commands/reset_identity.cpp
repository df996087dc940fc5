// `facet reset-identity`: another person sits down.

#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "daemon_options.hpp"

namespace facet::tools {

void add_reset_identity_command(Command app) {
  const Command command = app.subcommand(
      "reset-identity", "Let the daemon estimate identity and focal length anew from the next good frames");
  const auto options = add_daemon_options(command);
  command.callback([options] { call_daemon(*options, "identity.reset", nlohmann::json::object()); });
}

}  // namespace facet::tools
