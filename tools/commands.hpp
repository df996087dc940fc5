#pragma once

#include <memory>

#include "options.hpp"

namespace facet::tools {

class Team;

/// Each adds one subcommand of `facet` to the program: its options, its help text and the callback that runs
/// it. A callback reports failure by throwing facet::Error; main turns the error's kind into the exit status.
/// One line here, one in main.cpp's list and one file command_<name>.cpp make a new subcommand.

void add_animate_command(Command app);
void add_booth_demo_command(Command app);
void add_calibrate_command(Command app);
void add_doctor_command(Command app);
void add_summary_command(Command app);
void add_eval_command(Command app);
void add_export_command(Command app);
void add_model_command(Command app);
void add_neutral_command(Command app);
void add_patterns_command(Command app);
void add_play_command(Command app);
void add_pose_command(Command app);
void add_synth_command(Command app);
void add_synth_booth_command(Command app);
void add_view_command(Command app);
void add_watch_command(Command app);
/// join: called once, by a run that reads a booth's take.
Command add_process_command(Command app, std::unique_ptr<Team> (*join)());
void add_record_command(Command app);
void add_report_command(Command app);
void add_reset_identity_command(Command app);
void add_retarget_command(Command app);
void add_rig_command(Command app);
void add_scan_command(Command app);
void add_shutdown_command(Command app);
void add_status_command(Command app);
void add_takes_command(Command app);
void add_trigger_diagram_command(Command app);

}  // namespace facet::tools
