// `facet-team`: `facet process` of a booth's take by the processes that mpirun starts.

#include "depth_team.hpp"
#include "mpi_team.hpp"
#include "options.hpp"

int main(int argc, char** argv) {
  using namespace facet::tools;
  const ProgramTexts texts{
      "facet-team",
      "Facet on several machines: mpirun -n 4 --host a,b,c,d facet-team process --rig RIG ... finds the "
      "depth maps of "
      "a booth's take together.",
      "Every machine needs this program, the rig file and the take under the same paths. Exit status: as of "
      "`facet`."};
  const auto add_commands = [](Command program) {
    add_process_command(program, join_mpi_team).named("--rig").required();
  };
  return run_program(texts, add_commands, argc, argv);
}
