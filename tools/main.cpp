// `facet`: the command-line program. Thin: each subcommand parses its options and calls the rooms.

#include "commands.hpp"
#include "depth_team.hpp"
#include "options.hpp"

int main(int argc, char** argv) {
  using namespace facet::tools;
  const ProgramTexts texts{
      "facet",
      "Facet: facial-performance capture. Turns video of a face into refined meshes, and works with takes.",
      "Exit status: 0 done, 1 internal fault, 2 usage, 3 unreadable input, 4 no face found, 5 no usable "
      "Vulkan\n"
      "device, 6 cannot write, 7 the daemon does not answer. `facet COMMAND --help` explains a command."};
  const auto add_commands = [](Command app) {
    add_animate_command(app);
    add_booth_demo_command(app);
    add_calibrate_command(app);
    add_doctor_command(app);
    add_eval_command(app);
    add_export_command(app);
    add_model_command(app);
    add_neutral_command(app);
    add_patterns_command(app);
    add_play_command(app);
    add_pose_command(app);
    add_summary_command(app);
    add_synth_command(app);
    add_synth_booth_command(app);
    add_view_command(app);
    add_watch_command(app);
    add_process_command(app, join_nobody);
    add_record_command(app);
    add_report_command(app);
    add_reset_identity_command(app);
    add_retarget_command(app);
    add_rig_command(app);
    add_scan_command(app);
    add_shutdown_command(app);
    add_status_command(app);
    add_takes_command(app);
    add_trigger_diagram_command(app);
  };
  return run_program(texts, add_commands, argc, argv);
}
