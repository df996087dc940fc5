#include "daemon_options.hpp"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "service/config.hpp"
#include "service/control_client.hpp"

namespace facet::tools {

std::shared_ptr<DaemonOptions> add_daemon_options(CLI::App& command) {
  auto options = std::make_shared<DaemonOptions>();
  auto* socket = command.add_option(
      "--socket", options->socket,
      "Control socket of the daemon (default " + service::ControlConfig().socket.string() + ")");
  command
      .add_option("--config", options->config, "The daemon's configuration, which names its control socket")
      ->excludes(socket);
  return options;
}

nlohmann::json call_daemon(const DaemonOptions& options, const std::string& method,
                           const nlohmann::json& params) {
  std::filesystem::path socket = options.socket;
  if (socket.empty()) {
    const service::Config config =
        options.config.empty() ? service::default_config() : service::load_config(options.config);
    socket = config.control.socket;
  }
  return service::ControlClient(socket).call(method, params);
}

}  // namespace facet::tools
