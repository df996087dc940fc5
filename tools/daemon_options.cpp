#include "daemon_options.hpp"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "service/config.hpp"
#include "service/control_client.hpp"
#include "service/default_paths.hpp"

namespace facet::tools {

std::shared_ptr<DaemonOptions> add_daemon_options(CLI::App& command) {
  auto options = std::make_shared<DaemonOptions>();
  auto* socket = command.add_option("--socket", options->socket,
                                    "Control socket of the daemon (default: that of the configuration)");
  command
      .add_option("--config", options->config,
                  "The daemon's configuration, which names its control socket (default " +
                      service::default_config_file().string() + ", where it exists)")
      ->excludes(socket);
  return options;
}

nlohmann::json call_daemon(const DaemonOptions& options, const std::string& method,
                           const nlohmann::json& params) {
  std::filesystem::path socket = options.socket;
  if (socket.empty()) {
    const std::string file = options.config.empty() ? service::installed_config_file() : options.config;
    const service::Config config = file.empty() ? service::default_config() : service::load_config(file);
    socket = config.control.socket;
  }
  return service::ControlClient(socket).call(method, params);
}

}  // namespace facet::tools
