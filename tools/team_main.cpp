// `facet-team`: `facet process` of a booth's take by the processes that mpirun starts.

#include <CLI/CLI.hpp>

#include "commands.hpp"
#include "mpi_team.hpp"
#include "program.hpp"

int main(int argc, char** argv) {
  using namespace facet::tools;
  CLI::App app{
      "Facet on several machines: mpirun -n 4 --host a,b,c,d facet-team process --rig RIG ... finds the "
      "depth maps of "
      "a booth's take together."};
  app.name("facet-team");
  app.footer(
      "Every machine needs this program, the rig file and the take under the same paths. Exit status: as of "
      "`facet`.");
  add_process_command(app, join_mpi_team);
  app.get_subcommand("process")->get_option("--rig")->required();
  return run_program(app, argc, argv);
}
