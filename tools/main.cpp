// `facet`: the command-line program. Thin: each subcommand parses its options and calls the rooms.

#include "options.hpp"

namespace facet::tools {
void add_commands(Command program);  // made by commands/CMakeLists.txt
}

int main(int argc, char** argv) {
  using namespace facet::tools;
  const ProgramTexts texts{
      "facet",
      "Facet: facial-performance capture. Turns video of a face into refined meshes, and works with takes.",
      "Exit status: 0 done, 1 internal fault, 2 usage, 3 unreadable input, 4 no face found, 5 no usable "
      "Vulkan\n"
      "device, 6 cannot write, 7 the daemon does not answer, or a file is in use. `facet COMMAND --help`\n"
      "explains a command."};
  return run_program(texts, add_commands, argc, argv);
}
