#include "daemon_options.hpp"

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "service/config.hpp"
#include "service/control_client.hpp"
#include "service/default_paths.hpp"

namespace facet::tools {
namespace {

service::Config config_of(const std::string& named) {
  const std::string file = named.empty() ? service::installed_config_file() : named;
  return file.empty() ? service::default_config() : service::load_config(file);
}

}  // namespace

std::filesystem::path StreamOptions::path() const {
  if (!socket.empty()) {
    return socket;
  }
  const char* environment = std::getenv("FACET_SOCKET");
  if (config.empty() && environment != nullptr && environment[0] != '\0') {
    return environment;
  }
  return config_of(config).stream.socket;
}

std::shared_ptr<StreamOptions> add_stream_options(Command command, const std::string& purpose) {
  auto options = std::make_shared<StreamOptions>();
  command.option("--socket", options->socket,
                 purpose + " (default: $FACET_SOCKET, else that of the configuration)");
  command
      .option("--config", options->config,
              "The daemon's configuration, which names its stream's socket (default " +
                  service::default_config_file().string() + ", where it exists)")
      .excludes("--socket");
  return options;
}

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
    socket = config_of(options.config).control.socket;
  }
  // A slow disk may take its time for the beginning and the end of a take, and for what is changed in the
  // takes' folder; all else is answered at once.
  const bool waits_for_disk = method.starts_with("record.") || method.starts_with("person.") ||
                              (method.starts_with("takes.") && method != "takes.list");
  return service::ControlClient(socket, std::chrono::seconds(waits_for_disk ? 60 : 10)).call(method, params);
}

nlohmann::json call_daemon(const DaemonOptions& options, const std::string& method) {
  return call_daemon(options, method, nlohmann::json::object());
}

void add_question(Command program, const std::string& name, const std::string& help,
                  const std::string& method, void (*print)(const nlohmann::json& answer)) {
  const Command command = program.subcommand(name, help);
  const auto options = add_daemon_options(command);
  const auto as_json = std::make_shared<bool>(false);
  command.flag("--json", *as_json, "Print the daemon's answer as JSON");
  command.callback([options, as_json, method, print] {
    const nlohmann::json answer = call_daemon(*options, method);
    if (*as_json) {
      std::puts(answer.dump(2, ' ', true).c_str());
    } else {
      print(answer);
    }
  });
}

}  // namespace facet::tools
