#include "options.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <utility>

#include "facet/error.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

/// The word that stands where a subcommand should, as it was typed; nothing where there is none, or a command
/// that wants no subcommand is at fault.
std::optional<std::string> unknown_command(const CLI::App& app) {
  const CLI::App* at = &app;
  while (!at->get_subcommands().empty()) {
    at = at->get_subcommands().front();
  }
  const std::vector<std::string> words = app.remaining(true);
  const bool wanted = at->get_require_subcommand_min() > 0 && !words.empty();
  return wanted ? std::optional<std::string>(words.front()) : std::nullopt;
}

}  // namespace

const Option& Option::required() const {
  option_->required();
  return *this;
}

const Option& Option::shows_default() const {
  option_->capture_default_str();
  return *this;
}

const Option& Option::range(int least, int most) const {
  option_->check(CLI::Range(least, most));
  return *this;
}

const Option& Option::range(double least, double most) const {
  option_->check(CLI::Range(least, most));
  return *this;
}

const Option& Option::positive() const {
  option_->check(CLI::PositiveNumber);
  return *this;
}

const Option& Option::one_of(const std::vector<std::string>& values) const {
  option_->check(CLI::IsMember(values));
  return *this;
}

const Option& Option::ends_in(const std::vector<std::string>& extensions) const {
  option_->check([extensions](const std::string& file) {
    if (std::count(extensions.begin(), extensions.end(), std::filesystem::path(file).extension()) > 0) {
      return std::string();
    }
    const auto last = extensions.end() - 1;
    return fmt::format("'{}' must end in {}{}{}", file, fmt::join(extensions.begin(), last, ", "),
                       extensions.size() > 1 ? " or " : "", *last);
  });
  return *this;
}

const Option& Option::existing_folder() const {
  option_->check(CLI::ExistingDirectory);
  return *this;
}

const Option& Option::expected(int count) const {
  option_->expected(count);
  return *this;
}

const Option& Option::delimiter(char between) const {
  option_->delimiter(between);
  return *this;
}

const Option& Option::one_at_a_time() const {
  option_->allow_extra_args(false);
  return *this;
}

const Option& Option::needs(const std::string& other) const {
  option_->needs(other);
  return *this;
}

const Option& Option::excludes(const std::string& other) const {
  option_->excludes(other);
  return *this;
}

Command Command::subcommand(const std::string& name, const std::string& help) const {
  return Command(app_->add_subcommand(name, help));
}

template <typename T>
Option Command::option(const std::string& names, T& variable, const std::string& help) const {
  return Option(app_->add_option(names, variable, help));
}

template Option Command::option(const std::string&, std::string&, const std::string&) const;
template Option Command::option(const std::string&, std::filesystem::path&, const std::string&) const;
template Option Command::option(const std::string&, int&, const std::string&) const;
template Option Command::option(const std::string&, std::uint64_t&, const std::string&) const;
template Option Command::option(const std::string&, float&, const std::string&) const;
template Option Command::option(const std::string&, double&, const std::string&) const;
template Option Command::option(const std::string&, std::optional<std::uint64_t>&, const std::string&) const;
template Option Command::option(const std::string&, std::optional<double>&, const std::string&) const;
template Option Command::option(const std::string&, std::vector<float>&, const std::string&) const;
template Option Command::option(const std::string&, std::vector<std::string>&, const std::string&) const;

Option Command::flag(const std::string& names, bool& variable, const std::string& help) const {
  return Option(app_->add_flag(names, variable, help));
}

Option Command::named(const std::string& name) const {
  return Option(app_->get_option(name));
}

void Command::requires_subcommand() const {
  app_->require_subcommand(1);
}

void Command::footer(const std::string& text) const {
  app_->footer(text);
}

void Command::callback(std::function<void()> run) const {
  app_->callback(std::move(run));
}

int run_program(const ProgramTexts& texts, const std::function<void(Command)>& add_commands, int argc,
                char** argv) {
#if defined(__AVX2__) && defined(__FMA__)
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) {
    tell(stderr, "{}: this build needs a processor with AVX2 and FMA; rebuild with -DFACET_MARCH=x86-64\n",
         texts.name);
    return static_cast<int>(ErrorKind::Internal);
  }
#endif
  CLI::App app(texts.description, texts.name);
  app.footer(texts.footer);
  add_commands(Command(&app));
  app.set_version_flag("--version", FACET_VERSION);
  app.require_subcommand(1);
  app.fallthrough(false);
  try {
    app.parse(argc, argv);
  } catch (const CLI::RequiredError& error) {
    if (const auto word = unknown_command(app)) {
      tell(stderr, "{}: there is no command or option '{}' ({} --help lists them)\n", texts.name, *word,
           texts.name);
    } else {
      app.exit(error);
    }
    return static_cast<int>(ErrorKind::Usage);
  } catch (const CLI::ParseError& error) {
    const int status = app.exit(error);
    return status == 0 ? 0 : static_cast<int>(ErrorKind::Usage);
  } catch (const Error& error) {
    tell(stderr, "{}: {}\n", texts.name, error.what());
    return static_cast<int>(error.kind());
  } catch (const std::exception& error) {
    tell(stderr, "{}: internal fault: {}\n", texts.name, error.what());
    return static_cast<int>(ErrorKind::Internal);
  }
  return 0;
}

std::optional<int> read_int(const std::string& text) {
  int number = 0;
  return CLI::detail::lexical_cast(text, number) ? std::optional<int>(number) : std::nullopt;
}

}  // namespace facet::tools
