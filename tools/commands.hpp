#pragma once

#include <memory>

namespace CLI {
class App;
}

namespace facet::tools {

class Team;

/// Each adds one subcommand of `facet` to the program: its options, its help text and the callback that runs
/// it. A callback reports failure by throwing facet::Error; main turns the error's kind into the exit status.
/// One line here, one in main.cpp's list and one file command_<name>.cpp make a new subcommand.

void add_animate_command(CLI::App& app);
void add_booth_demo_command(CLI::App& app);
void add_calibrate_command(CLI::App& app);
void add_doctor_command(CLI::App& app);
void add_summary_command(CLI::App& app);
void add_eval_command(CLI::App& app);
void add_export_command(CLI::App& app);
void add_model_command(CLI::App& app);
void add_neutral_command(CLI::App& app);
void add_patterns_command(CLI::App& app);
void add_play_command(CLI::App& app);
void add_pose_command(CLI::App& app);
void add_synth_command(CLI::App& app);
void add_synth_booth_command(CLI::App& app);
void add_view_command(CLI::App& app);
void add_watch_command(CLI::App& app);
/// join: called once, by a run that reads a booth's take.
void add_process_command(CLI::App& app, std::unique_ptr<Team> (*join)());
void add_record_command(CLI::App& app);
void add_report_command(CLI::App& app);
void add_reset_identity_command(CLI::App& app);
void add_retarget_command(CLI::App& app);
void add_rig_command(CLI::App& app);
void add_scan_command(CLI::App& app);
void add_shutdown_command(CLI::App& app);
void add_status_command(CLI::App& app);
void add_takes_command(CLI::App& app);
void add_trigger_diagram_command(CLI::App& app);

}  // namespace facet::tools
