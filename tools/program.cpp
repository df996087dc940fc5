#include "program.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "facet/error.hpp"
#include "tell.hpp"

namespace facet::tools {

int run_program(CLI::App& app, int argc, char** argv) {
#if defined(__AVX2__) && defined(__FMA__)
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) {
    tell(stderr, "{}: this build needs a processor with AVX2 and FMA; rebuild with -DFACET_MARCH=x86-64\n",
         app.get_name());
    return static_cast<int>(ErrorKind::Internal);
  }
#endif
  app.set_version_flag("--version", FACET_VERSION);
  app.require_subcommand(1);
  app.fallthrough(false);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    const int status = app.exit(error);
    return status == 0 ? 0 : static_cast<int>(ErrorKind::Usage);
  } catch (const Error& error) {
    tell(stderr, "{}: {}\n", app.get_name(), error.what());
    return static_cast<int>(error.kind());
  } catch (const std::exception& error) {
    tell(stderr, "{}: internal fault: {}\n", app.get_name(), error.what());
    return static_cast<int>(ErrorKind::Internal);
  }
  return 0;
}

}  // namespace facet::tools
