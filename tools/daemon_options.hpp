#pragma once

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

/// Calls a control method of the daemon. Throws Error(Unavailable) where it does not answer, and its own
/// error else.
nlohmann::json call_daemon(const DaemonOptions& options, const std::string& method,
                           const nlohmann::json& params);
nlohmann::json call_daemon(const DaemonOptions& options, const std::string& method);

/// A subcommand that asks the daemon one thing and prints the answer; with --json as it came.
void add_question(Command program, const std::string& name, const std::string& help,
                  const std::string& method, void (*print)(const nlohmann::json& answer));

}  // namespace facet::tools
