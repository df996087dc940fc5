#include "daemon_options.hpp"

#include <chrono>
#include <nlohmann/json.hpp>

#include "service/config.hpp"
#include "service/control_client.hpp"
#include "service/default_paths.hpp"

namespace facet::tools {

std::shared_ptr<DaemonOptions> add_daemon_options(Command command) {
  auto options = std::make_shared<DaemonOptions>();
  command.option("--socket", options->socket,
                 "Control socket of the daemon (default: that of the configuration)");
  command
      .option("--config", options->config,
              "The daemon's configuration, which names its control socket (default " +
                  service::default_config_file().string() + ", where it exists)")
      .excludes("--socket");
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
  // A slow disk may take its time for the beginning and the end of a take; all else is answered at once.
  const bool waits_for_disk = method.starts_with("record.");
  return service::ControlClient(socket, std::chrono::seconds(waits_for_disk ? 60 : 10)).call(method, params);
}

}  // namespace facet::tools
