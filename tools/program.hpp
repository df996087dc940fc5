#pragma once

namespace CLI {
class App;
}

namespace facet::tools {

/// Runs the subcommand that the arguments name, and says on stderr what went wrong. Returns the exit status:
/// 0, or the number of the error's kind. Main thread.
int run_program(CLI::App& app, int argc, char** argv);

}  // namespace facet::tools
