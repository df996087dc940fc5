// `facet`: the command-line program. Thin: each subcommand parses its options and calls the rooms.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "commands.hpp"
#include "facet/error.hpp"

int main(int argc, char** argv) {
  using namespace facet::tools;
#if defined(__AVX2__) && defined(__FMA__)
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) {
    std::fputs("facet: this build needs a processor with AVX2 and FMA; rebuild with -DFACET_MARCH=x86-64\n",
               stderr);
    return static_cast<int>(facet::ErrorKind::Internal);
  }
#endif
  CLI::App app{
      "Facet: facial-performance capture. Turns video of a face into refined meshes, and works with takes."};
  app.name("facet");
  app.set_version_flag("--version", FACET_VERSION);
  app.require_subcommand(1);
  app.fallthrough(false);
  app.footer(
      "Exit status: 0 done, 1 internal fault, 2 usage, 3 unreadable input, 4 no face found, 5 no usable "
      "Vulkan\n"
      "device, 6 cannot write, 7 the daemon does not answer. `facet COMMAND --help` explains a command.");

  add_booth_demo_command(app);
  add_calibrate_command(app);
  add_doctor_command(app);
  add_eval_command(app);
  add_export_command(app);
  add_model_command(app);
  add_patterns_command(app);
  add_summary_command(app);
  add_synth_command(app);
  add_synth_booth_command(app);
  add_view_command(app);
  add_watch_command(app);
  add_process_command(app);
  add_record_command(app);
  add_reset_identity_command(app);
  add_rig_command(app);
  add_scan_command(app);
  add_shutdown_command(app);
  add_status_command(app);
  add_takes_command(app);
  add_trigger_diagram_command(app);

  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    const int status = app.exit(error);
    return status == 0 ? 0 : static_cast<int>(facet::ErrorKind::Usage);
  } catch (const facet::Error& error) {
    fmt::print(stderr, "facet: {}\n", error.what());
    return static_cast<int>(error.kind());
  } catch (const std::exception& error) {
    fmt::print(stderr, "facet: internal fault: {}\n", error.what());
    return static_cast<int>(facet::ErrorKind::Internal);
  }
  return 0;
}
