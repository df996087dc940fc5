// `facet trigger-diagram LOG -o PNG`: what a trigger's lines did, as a timing diagram.

#include <fmt/format.h>

#include <chrono>
#include <fstream>
#include <memory>
#include <string>

#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/text_file.hpp"
#include "options.hpp"
#include "render/renderer.hpp"
#include "report/trigger_diagram.hpp"
#include "tell.hpp"
#include "trigger/edge_log.hpp"
#include "trigger/virtual_trigger.hpp"

namespace facet::tools {
namespace {

struct Options {
  std::string log;
  std::string output;
  std::uint64_t slots = 3;
  bool record = false;
};

/// Two cameras (a trigger pulse; the whole exposure) and two projectors: pattern A, pattern B, blank.
TriggerProgram sample_program() {
  TriggerProgram program;
  program.lines.resize(4);
  program.lines[0].name = "camera.left";
  program.lines[0].pulse_ns = 1'000'000;
  program.lines[1].name = "camera.right";
  program.lines[2].name = "projector.a";
  program.lines[2].role = LineRole::Projector;
  program.lines[3].name = "projector.b";
  program.lines[3].role = LineRole::Projector;
  program.patterns = {0b0100, 0b1000, 0};
  program.settle_ns = 2'000'000;
  program.exposure_ns = 8'000'000;
  return program;
}

/// Runs the sample program without wires until so many slots were fired or dropped.
void record(const Options& options) {
  trigger::VirtualTriggerOptions trigger_options;
  trigger_options.thread.real_time = true;
  trigger_options.read_back = 0b0001;
  const auto trigger = trigger::make_virtual_trigger(sample_program(), trigger_options);
  trigger::EdgeLog log{trigger->program().lines, {}};
  trigger->start(0);
  TriggerEvent event;
  while (event.slot <= options.slots && trigger->next(event, std::chrono::seconds(2))) {
    log.events.push_back(event);
  }
  trigger->stop();
  tell("{}\n", trigger->status().scheduling);
  files::OutputFile output(options.log);
  output.write(trigger::to_text(log));
  output.commit();
}

void run(const Options& options) {
  if (options.record) {
    record(options);
  }
  constexpr std::size_t kMostBytes = 256U << 20;  // a million events have a third of it
  const std::string text = files::read_text(options.log, kMostBytes, "edge log");
  render::write_png(report::draw_trigger_diagram(trigger::parse_edge_log(text, options.log), options.slots),
                    options.output);
}

}  // namespace

void add_trigger_diagram_command(Command app) {
  auto options = std::make_shared<Options>();
  const Command command =
      app.subcommand("trigger-diagram", "Draw the edges of a trigger's lines from a recorded edge log");
  command.option("log", options->log, "The edge log").required();
  command.option("-o,--output", options->output, "PNG to write").required();
  command.option("--slots", options->slots, "How many slots to show").range(1, 1000);
  command.flag("--record", options->record,
               "First run a sample program on lines without wires and write the log: shows how exactly this "
               "machine keeps time");
  command.callback([options] { run(*options); });
}

}  // namespace facet::tools
