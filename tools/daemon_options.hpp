#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "options.hpp"

namespace facet::tools {

/// Which daemon a command talks to: the options of every such command.
struct DaemonOptions {
  std::string socket;  ///< empty: that of the configuration
  std::string config;  ///< empty: the installed one, where there is one, else the defaults
};

/// Adds --socket and --config to a subcommand.
std::shared_ptr<DaemonOptions> add_daemon_options(Command command);

/// Where the stream of a daemon is: what --socket names, else the configuration that --config names, else
/// FACET_SOCKET of the environment, else the installed configuration, else the default's place.
struct StreamOptions {
  std::string socket;  ///< empty: not named
  std::string config;  ///< empty: not named

  /// Throws what load_config throws.
  std::filesystem::path path() const;
};

/// Adds --socket and --config to a subcommand that reads a stream, or plays one. purpose: of the socket, for
/// the help.
std::shared_ptr<StreamOptions> add_stream_options(Command command, const std::string& purpose);

/// Calls a control method of the daemon. Throws Error(Unavailable) where it does not answer, and its own
/// error else.
nlohmann::json call_daemon(const DaemonOptions& options, const std::string& method,
                           const nlohmann::json& params);
nlohmann::json call_daemon(const DaemonOptions& options, const std::string& method);

/// A subcommand that asks the daemon one thing and prints the answer; with --json as it came.
void add_question(Command program, const std::string& name, const std::string& help,
                  const std::string& method, void (*print)(const nlohmann::json& answer));

}  // namespace facet::tools
