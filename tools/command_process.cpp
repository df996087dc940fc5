// `facet process INPUT -o TAKE`: every frame of a recording becomes a frame of a take.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <ctime>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "commands.hpp"
#include "facet/error.hpp"
#include "pipeline/monocular.hpp"
#include "pipeline/take_sink.hpp"
#include "progress.hpp"
#include "service/config.hpp"
#include "stop_signals.hpp"
#include "take_frames.hpp"

namespace facet::tools {
namespace {

/// Between two looks at the pipeline, for the progress line.
constexpr timespec kPeriod{0, 50'000'000};

struct Options {
  std::string input;
  std::string take;
  std::string config;
  std::string frames;
  std::string budget;
  std::string device;
};

void set_budget(const std::string& budget, refine::RefinerConfig& refiner) {
  refiner.paper_budget = budget == "paper";
  if (refiner.paper_budget) {
    return;
  }
  int steps = 0;
  if (!CLI::detail::lexical_cast(budget, steps) || steps < 1 || steps > 100) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("--budget {}: must be \"paper\" or Gauss-Newton steps per level, 1 to 100", budget));
  }
  refiner.gauss_newton_steps = steps;
}

service::Config configure(const Options& options) {
  service::Config config =
      options.config.empty() ? service::default_config() : service::load_config(options.config);
  pipeline::MonocularConfig& monocular = config.pipeline;
  monocular.source = {};
  monocular.source.path = options.input;
  if (!options.frames.empty()) {
    monocular.frames = pipeline::parse_frame_range(options.frames);
  }
  if (!options.budget.empty()) {
    set_budget(options.budget, monocular.refiner);
  }
  if (!options.device.empty()) {
    monocular.gpu_device = options.device;
  }
  return config;
}

/// How many frames of the range the source says it has; 0 where it does not know.
std::uint64_t expected_frames(const CameraInfo& source, const pipeline::FrameRange& range) {
  if (!source.frame_count) {
    return 0;
  }
  const std::uint64_t end = std::min(range.end, *source.frame_count);
  return end > range.first ? end - range.first : 0;
}

std::string note(const pipeline::PipelineStatus& status) {
  if (status.state == pipeline::PipelineState::Preparing) {
    return "looking ahead for the face";
  }
  return fmt::format("{}, {} refined{}", mesh::to_string(status.tracking), status.refined_frames,
                     status.degraded_frames > 0 ? fmt::format(", {} degraded", status.degraded_frames) : "");
}

/// Runs the pipeline to its end; returns the signal that broke it off, or 0.
int run_to_end(pipeline::MonocularPipeline& pipeline, const StopSignals& signals, std::uint64_t expected) {
  Progress progress("Processing", expected);
  int broken_off_by = 0;
  pipeline.start();
  while (!pipeline.finished()) {
    if (const int signal = signals.wait(kPeriod); signal != 0) {
      broken_off_by = signal;
      pipeline.request_stop();
    }
    const pipeline::PipelineStatus status = pipeline.status();
    progress.set(status.processed, note(status));
  }
  pipeline.stop();
  progress.set(pipeline.status().processed, note(pipeline.status()));
  return broken_off_by;
}

void check_result(const Options& options, const pipeline::PipelineStatus& status) {
  if (status.state == pipeline::PipelineState::Failed) {
    throw Error(status.failure_kind, status.reason);
  }
  if (status.processed == 0) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("'{}' has no frame in the range asked for: choose another with --frames", options.input));
  }
  if (status.mesh_frames == 0) {
    throw Error(
        ErrorKind::NoFace,
        status.face_frames == 0
            ? fmt::format(
                  "no face found in the {} frames of '{}': give a video in which one face looks towards "
                  "the camera, upright and lit",
                  status.processed, options.input)
            : fmt::format(
                  "a face was seen in {} of {} frames of '{}', but never well enough to track it: give "
                  "a video in which it is larger, wholly in the picture and sharper",
                  status.face_frames, status.processed, options.input));
  }
}

void run(const Options& options) {
  const service::Config config = configure(options);
  const StopSignals signals;
  pipeline::Stages stages = pipeline::open_stages(config.pipeline);
  const CameraInfo source = stages.camera->info();

  take::TakeRecorderConfig recorder;
  recorder.file = options.take;
  recorder.source = options.input;
  recorder.software = "facet process " FACET_VERSION;
  recorder.when_full = take::WhenFull::Wait;
  recorder.disk_reserve_bytes = config.takes.disk_reserve_bytes;
  recorder.compression_level = config.takes.compression_level;
  pipeline::TakeSink take;
  take.begin(recorder);

  pipeline::MonocularPipeline pipeline(std::move(stages),
                                       {config.pipeline.hierarchy, config.pipeline.frames, {}}, {&take});
  const int broken_off_by = run_to_end(pipeline, signals, expected_frames(source, config.pipeline.frames));
  const std::optional<take::RecorderStatus> written = take.end();
  for (const pipeline::Messages::Message& message : pipeline.take_messages()) {
    fmt::print(stderr, "facet: {}{}\n", message.warning ? "warning: " : "", message.text);
  }
  if (written && written->state == take::RecorderState::Failed) {
    throw Error(ErrorKind::Storage, fmt::format("'{}': {}", options.take, written->reason));
  }
  const pipeline::PipelineStatus status = pipeline.status();
  if (status.mesh_frames == 0) {
    // A take without a mesh serves nobody, and would be in the way of the next attempt.
    std::error_code ignored;
    std::filesystem::remove(options.take, ignored);
  }
  if (broken_off_by != 0) {
    fmt::print(stderr, "facet: broken off: {}\n",
               status.mesh_frames == 0
                   ? "no mesh was made yet, nothing is left"
                   : fmt::format("'{}' holds the first {} frames", options.take, status.processed));
    signals.die_of(broken_off_by);
  }
  check_result(options, status);
  if (status.degraded_frames > 0) {
    fmt::print(stderr, "facet: warning: {} frames are degraded, the last one because: {}\n",
               status.degraded_frames, status.degraded_reason);
  }
  fmt::print("{}: {} frames, {} with a mesh, {} refined, {:.1f} MB\n", options.take, status.processed,
             status.mesh_frames, status.refined_frames,
             static_cast<double>(written ? written->bytes : 0) / 1e6);
}

}  // namespace

void add_process_command(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("process", "Turn a video of a face into a take, every frame");
  command->add_option("input", options->input, "The video")->required();
  command->add_option("-o,--output", options->take, "The take to write; must not exist yet")->required();
  command->add_option("--config", options->config,
                      "Configuration file; of [source], only frames and intrinsics count");
  command->add_option("--frames", options->frames, kFramesHelp);
  command->add_option("--budget", options->budget,
                      "Solver work per frame: \"paper\" or Gauss-Newton steps per level");
  command->add_option("--device", options->device,
                      "Vulkan device: auto, part of its name, or none (coarse meshes only)");
  command->callback([options] { run(*options); });
}

}  // namespace facet::tools
