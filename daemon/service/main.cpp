// `facetd`: the daemon.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <cstdio>
#include <exception>
#include <new>
#include <string>
#include <system_error>

#include "facet/error.hpp"
#include "facet/printable.hpp"
#include "facet/system_error.hpp"
#include "service/config.hpp"
#include "service/default_paths.hpp"
#include "service/descriptors.hpp"
#include "service/log.hpp"
#include "service/memory_reserve.hpp"
#include "service/modes.hpp"
#include "service/service.hpp"

namespace {

int run(const std::string& file, bool check_only) {
  facet::service::Config config = facet::service::load_config(file);
  facet::service::require_source(config, file);
  if (check_only) {
    for (const std::string& warning : config.warnings) {
      fmt::print(stderr, "facetd: warning: {}\n", facet::printable(warning));
    }
    fmt::print("{}: good\n", facet::printable(file));
    return 0;
  }
  facet::service::Log log(config.log_level);
  for (const std::string& warning : config.warnings) {
    log.warning(warning);
  }
  if (const std::string lowered =
          facet::service::fit_descriptors(config, facet::service::raise_descriptor_limit());
      !lowered.empty()) {
    log.warning(lowered);
  }
  return facet::service::Service(config, log).run();
}

}  // namespace

int main(int argc, char** argv) {
  facet::service::hold_signals();
  const facet::service::MemoryReserve reserve;
#if defined(__AVX2__) && defined(__FMA__)
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) {
    std::fputs("facetd: this build needs a processor with AVX2 and FMA; rebuild with -DFACET_MARCH=x86-64\n",
               stderr);
    return static_cast<int>(facet::ErrorKind::Internal);
  }
#endif
  CLI::App app{
      "facetd: turns what cameras see into a stream of refined face meshes, and records takes of it."};
  app.name("facetd");
  app.set_version_flag("--version", FACET_VERSION);
  app.footer(
      "Exit status: 0 stopped on request or at the source's end, 1 internal fault, 2 usage or "
      "configuration,\n"
      "3 unreadable source, model or configuration, 5 no usable Vulkan device, 6 cannot write or socket path "
      "taken,\n7 something is short or does not answer: another try may help. systemd tries again after all "
      "but 0, 2 and 3.\nA source that ends or fails while the daemon runs ends it only with "
      "source.exit_at_end: with "
      "3 where it\nfailed or is truncated or damaged.");
  std::string file = facet::service::default_config_file().string();
  bool check_only = false;
  app.add_option("--config", file, "The configuration file (TOML), see facet.toml(5)")->capture_default_str();
  app.add_flag("--check-config", check_only, "Only check the configuration file");
  facet::service::Log log;
  try {
    app.parse(argc, argv);
    return run(file, check_only);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : static_cast<int>(facet::ErrorKind::Usage);
  } catch (const facet::Error& error) {
    log.error(error.what());
    return static_cast<int>(error.kind());
  } catch (const std::bad_alloc&) {
    log.error(facet::describe_errno(ENOMEM));
    return static_cast<int>(facet::ErrorKind::Unavailable);
  } catch (const std::system_error& error) {
    const bool passing = facet::may_pass(error.code().value());
    log.error(passing ? fmt::format("{} (another try may help)", error.what())
                      : fmt::format("internal fault: {}", error.what()));
    return static_cast<int>(facet::kind_of_errno(error.code().value(), facet::ErrorKind::Internal));
  } catch (const std::exception& error) {
    log.error(fmt::format("internal fault: {}", error.what()));
    return static_cast<int>(facet::ErrorKind::Internal);
  }
}
