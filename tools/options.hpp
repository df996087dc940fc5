#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace facet::tools {

/// The door to CLI11: every unit that includes it takes seconds more to compile, so options.cpp alone does.
/// Options and commands are handles, good until run_program returns. Main thread.

/// An option of a command; each call returns it for the next.
class Option {
 public:
  explicit Option(CLI::Option* option) : option_(option) {}

  const Option& required() const;
  /// The variable's value, as it is now, stands in the help text.
  const Option& shows_default() const;
  /// From least to most, both included; ints show as INT, doubles as FLOAT.
  const Option& range(int least, int most) const;
  const Option& range(double least, double most) const;
  const Option& positive() const;
  const Option& one_of(const std::vector<std::string>& values) const;
  /// A file name with one of these, as ".png".
  const Option& ends_in(const std::vector<std::string>& extensions) const;
  const Option& existing_folder() const;
  /// Of a list: how many values it has; what stands between them; one value each time that it is named.
  const Option& expected(int count) const;
  const Option& delimiter(char between) const;
  const Option& one_at_a_time() const;
  /// `other`, an option that the command has by now, must be given with it, or must not.
  const Option& needs(const std::string& other) const;
  const Option& excludes(const std::string& other) const;

 private:
  CLI::Option* option_;
};

/// A program or one of its subcommands.
class Command {
 public:
  explicit Command(CLI::App* app) : app_(app) {}

  Command subcommand(const std::string& name, const std::string& help) const;
  /// Without dashes in front of its names it is an argument. T: one of those at the end of options.cpp. The
  /// variable outlives the program's run.
  template <typename T>
  Option option(const std::string& names, T& variable, const std::string& help) const;
  Option flag(const std::string& names, bool& variable, const std::string& help) const;
  /// One that the command has.
  Option named(const std::string& name) const;
  void requires_subcommand() const;
  /// What the help text ends with.
  void footer(const std::string& text) const;
  /// Runs once the command's options are read.
  void callback(std::function<void()> run) const;

 private:
  CLI::App* app_;
};

struct ProgramTexts {
  std::string name;
  std::string description;
  std::string footer;
};

/// Runs the subcommand that the arguments name, and says on stderr what went wrong. Returns the exit status:
/// 0, or the number of the error's kind.
/// add_commands  gives the program its subcommands
int run_program(const ProgramTexts& texts, const std::function<void(Command program)>& add_commands, int argc,
                char** argv);

/// What an option makes of a whole number.
std::optional<int> read_int(const std::string& text);

}  // namespace facet::tools
