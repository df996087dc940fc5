// `facet process INPUT -o TAKE`: every frame of a recording becomes a frame of a take.

#include <fmt/format.h>

#include <algorithm>
#include <ctime>
#include <exception>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "booth/face_points.hpp"
#include "capture/rig_file.hpp"
#include "depth_team.hpp"
#include "facet/error.hpp"
#include "options.hpp"
#include "person/person_folder.hpp"
#include "persons.hpp"
#include "pipeline/booth_meshes.hpp"
#include "pipeline/picture_source.hpp"
#include "pipeline/shading.hpp"
#include "pipeline/take_sink.hpp"
#include "progress.hpp"
#include "report/depth_folder.hpp"
#include "service/config.hpp"
#include "slot_program.hpp"
#include "stop_signals.hpp"
#include "take/reader.hpp"
#include "take_frames.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

/// Between two looks at the pipeline, for the progress line.
constexpr timespec kPeriod{0, 50'000'000};
/// Blank slots of a booth whose depth is found together: their windows share slots.
constexpr int kBlanksPerRun = 3;

struct Options {
  std::vector<std::string> inputs;
  std::string input;  ///< the only one, or the first camera's video
  std::string take;
  std::string config;
  std::string frames;
  std::string budget;
  std::string detail;
  std::string device;
  std::string person;
  std::string rig;
  std::string depth;
  std::string points;
  std::string program;
  std::vector<std::string> cameras;
  bool every_slot = false;
  bool no_lights = false;
  bool shading = false;
  bool live = false;
};

void set_budget(const std::string& budget, refine::RefinerConfig& refiner) {
  if (budget == "auto" || budget == "paper") {
    refiner.budget = budget == "auto" ? refine::Budget::Auto : refine::Budget::Paper;
    return;
  }
  const int steps = read_int(budget).value_or(0);
  if (steps < 1 || steps > 100) {
    throw Error(
        ErrorKind::Usage,
        fmt::format("--budget {}: must be \"auto\", \"paper\" or Gauss-Newton steps per level, 1 to 100",
                    budget));
  }
  refiner.budget = refine::Budget::Fixed;
  refiner.gauss_newton_steps = steps;
}

bool is_take(const std::string& input) {
  return std::filesystem::path(input).extension() == ".take";
}

/// CAMERA=VIDEO, or a video that bears its camera's name.
struct NamedVideo {
  std::string camera;
  std::string file;
};

NamedVideo named_video(const std::string& given) {
  const std::size_t equals = given.find('=');
  if (equals == std::string::npos || equals == 0 || equals + 1 == given.size()) {
    return {std::filesystem::path(given).stem().string(), given};
  }
  return {given.substr(0, equals), given.substr(equals + 1)};
}

/// Whether the input is videos of a rig's cameras, not a booth's take.
bool has_views(const Options& options) {
  return options.inputs.size() > 1 ||
         (!options.rig.empty() && options.inputs.front().find('=') != std::string::npos);
}

/// The rig's cameras whose videos were given. Throws Error(Usage) where they do not agree.
std::vector<pipeline::RecordedCamera> views_of(const Options& options) {
  if (options.rig.empty()) {
    throw Error(
        ErrorKind::Usage,
        "several videos show one face only where their cameras are calibrated: give their rig file with "
        "--rig (facet calibrate makes one)");
  }
  const capture::Rig rig = capture::read_rig(options.rig);
  std::vector<pipeline::RecordedCamera> views;
  for (const std::string& given : options.inputs) {
    const NamedVideo video = named_video(given);
    for (const pipeline::RecordedCamera& other : views) {
      if (other.camera.name == video.camera) {
        throw Error(ErrorKind::Usage, fmt::format("camera '{}' is given twice", video.camera));
      }
    }
    pipeline::RecordedCamera view;
    view.camera = capture::camera_named(
        rig, options.rig, video.camera,
        fmt::format("name the video's camera, as in {}={}", rig.cameras.front().name, video.file));
    view.rig_file = options.rig;
    view.source.path = video.file;
    views.push_back(view);
  }
  return views;
}

/// The cameras of a take of frame sets that --cameras names. Throws Error(Usage) where they do not agree with
/// the rig's.
pipeline::OpenPictures views_of_take(const Options& options, const pipeline::FrameRange& slots) {
  const capture::Rig rig = capture::read_rig(options.rig);
  std::vector<capture::RigCamera> known;
  for (const std::string& name : options.cameras) {
    known.push_back(capture::camera_named(rig, options.rig, name, "name cameras of it with --cameras"));
    if (std::count(options.cameras.begin(), options.cameras.end(), name) > 1) {
      throw Error(ErrorKind::Usage, fmt::format("--cameras: '{}' is given twice", name));
    }
  }
  return [options, known, slots] {
    return pipeline::calibrated(pipeline::take_sets(options.input, options.cameras, slots), known,
                                options.rig);
  };
}

/// The pictures of a take that one live camera recorded. Throws Error(Usage) where it holds none, or several
/// cameras'.
pipeline::OpenPictures own_pictures_of_take(const Options& options, const pipeline::FrameRange& slots) {
  take::TakeReader take(options.input);
  for (std::int64_t i = 0; i < take.frame_count(); ++i) {
    const auto set = take.frame(i, take::Pictures::Described)->images;
    if (set == nullptr || take.info().picture_bytes == 0) {
      continue;
    }
    if (set->camera_names->size() != 1) {
      throw Error(ErrorKind::Usage,
                  fmt::format("'{}' holds pictures of {} cameras: give their rig file with --rig",
                              options.input, set->camera_names->size()));
    }
    return [file = options.input, name = set->camera_names->front(), slots] {
      return pipeline::take_sets(file, {name}, slots);
    };
  }
  throw Error(ErrorKind::Usage,
              fmt::format("'{}' holds no pictures to make meshes of: it was recorded from a video ('{}'; "
                          "process that), or with takes.pictures = false",
                          options.input, take.info().source));
}

service::Config configure(const Options& options) {
  service::Config config =
      options.config.empty() ? service::default_config() : service::load_config(options.config);
  pipeline::ShadingConfig& monocular = config.pipeline;
  monocular.source = {};
  monocular.source.path = options.input;
  if (!options.frames.empty()) {
    monocular.frames = pipeline::parse_frame_range(options.frames);
  }
  if (!options.budget.empty()) {
    set_budget(options.budget, monocular.refiner);
  }
  if (!options.detail.empty()) {
    refine::choose_detail(
        options.detail == "expressive" ? refine::Detail::Expressive : refine::Detail::Faithful,
        monocular.refiner);
  }
  if (!options.person.empty()) {
    monocular.person = options.person;
    if (!person::is_person_path(options.person)) {
      monocular.persons_folder = persons_folder(options.config);
    }
  }
  monocular.learn_ahead = !options.live;
  monocular.learn_live = false;
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
    return "looking at the recording first";
  }
  return fmt::format("{}, {} refined{}", mesh::to_string(status.tracking), status.refined_frames,
                     status.degraded_frames > 0 ? fmt::format(", {} degraded", status.degraded_frames) : "");
}

/// Runs the pipeline to its end; returns the signal that broke it off, or 0.
int run_to_end(pipeline::ShadingPipeline& pipeline, const StopSignals& signals, std::uint64_t expected) {
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

take::TakeRecorderConfig recorder_of(const Options& options, const service::Config& config) {
  take::TakeRecorderConfig recorder;
  recorder.file = options.take;
  recorder.source = std::filesystem::absolute(options.input).lexically_normal().string();
  recorder.software = "facet process " FACET_VERSION;
  recorder.when_full = take::WhenFull::Wait;
  recorder.disk_reserve_bytes = config.takes.disk_reserve_bytes;
  recorder.compression_level = config.takes.compression_level;
  return recorder;
}

/// The take stays, but whoever waits for it learns that it lacks what the video lost.
void check_whole(const Options& options, const pipeline::PipelineStatus& status) {
  if (!status.reason.empty()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("'{}' holds the {} frames that could be read, not the whole recording",
                            options.take, status.processed));
  }
}

/// What is to be told once all is written; throws where it came to nothing.
void conclude(const Options& options, const pipeline::PipelineStatus& status,
              const std::optional<take::RecorderStatus>& written,
              const std::vector<Messages::Message>& messages, int broken_off_by, const StopSignals& signals,
              const std::function<void()>& check) {
  for (const Messages::Message& message : messages) {
    tell(stderr, "facet: {}{}\n", message.warning ? "warning: " : "", message.text);
  }
  if (written && written->state == take::RecorderState::Failed) {
    throw Error(ErrorKind::Storage, fmt::format("'{}': {}", options.take, written->reason));
  }
  if (status.mesh_frames == 0) {
    // A take without a mesh serves nobody, and would be in the way of the next attempt.
    std::error_code ignored;
    std::filesystem::remove(options.take, ignored);
  }
  if (broken_off_by != 0) {
    tell(stderr, "facet: broken off: {}\n",
         status.mesh_frames == 0
             ? "no mesh was made yet, nothing is left"
             : fmt::format("'{}' holds the first {} frames", options.take, status.processed));
    signals.die_of(broken_off_by);
  }
  check();
  if (status.degraded_frames > 0) {
    tell(stderr, "facet: warning: {} frames are degraded, the last one because: {}\n", status.degraded_frames,
         status.degraded_reason);
  }
  tell("{}: {} frames, {} with a mesh, {} refined, {:.1f} MB\n", options.take, status.processed,
       status.mesh_frames, status.refined_frames, static_cast<double>(written ? written->bytes : 0) / 1e6);
}

void run_monocular(const Options& options) {
  service::Config config = configure(options);
  if (has_views(options)) {
    config.pipeline.views = views_of(options);
  }
  const StopSignals signals;
  const bool of_take = is_take(options.input) || !options.cameras.empty();
  pipeline::OpenPictures open;
  if (of_take) {
    open = options.cameras.empty() ? own_pictures_of_take(options, config.pipeline.frames)
                                   : views_of_take(options, config.pipeline.frames);
  }
  pipeline::ShadingParts stages = pipeline::open_shading(config.pipeline, open);
  const CameraInfo source = stages.pictures->cameras().front().info;
  // Of a take the slots of the range alone are counted.
  const std::uint64_t expected =
      of_take ? source.frame_count.value_or(0) : expected_frames(source, config.pipeline.frames);
  pipeline::TakeSink take;
  take.begin(recorder_of(options, config));
  pipeline::ShadingPipeline pipeline(std::move(stages),
                                     {config.pipeline.hierarchy, config.pipeline.frames, {}}, {&take});
  const int broken_off_by = run_to_end(pipeline, signals, expected);
  const std::optional<take::RecorderStatus> written =
      take.end(broken_off_by != 0 ? "broken off by a signal" : "");
  const pipeline::PipelineStatus status = pipeline.status();
  conclude(options, status, written, pipeline.take_messages(), broken_off_by, signals,
           [&] { check_result(options, status); });
  check_whole(options, status);
}

std::string booth_note(const pipeline::PipelineStatus& status) {
  return fmt::format("{}, {} meshes{}", mesh::to_string(status.tracking), status.mesh_frames,
                     status.degraded_frames > 0 ? fmt::format(", {} degraded", status.degraded_frames) : "");
}

bool is_blank(const capture::SlotProgram& program, std::uint64_t slot) {
  return capture::light_of_slot(program, slot).kind == capture::SlotLight::Kind::Blank;
}

/// What the booth's stages are to be made with. Throws Error(Usage) where the face is pointed at in a slot
/// that gets no mesh.
pipeline::BoothConfig booth_of(const Options& options, const service::Config& config, take::TakeReader& input,
                               const std::vector<std::int64_t>& slots) {
  pipeline::BoothConfig booth = service::booth_config(config);
  booth.points_file = options.points;
  if (!options.program.empty()) {
    booth.program = capture::parse_slot_program(options.program);
    booth.program_rules = true;
  } else {
    booth.program = recorded_program(input, slots).value_or(booth.program);
  }
  booth.every_slot = booth.every_slot || options.every_slot;
  booth.lights = booth.lights && !options.no_lights;
  booth.shading = booth.shading || options.shading;
  if (!options.points.empty()) {
    const std::uint64_t slot = booth::read_face_points(options.points).slot;
    const bool gets_a_mesh = std::any_of(slots.begin(), slots.end(), [&](std::int64_t i) {
      return input.entry(i).sequence == slot && is_blank(booth.program, slot);
    });
    if (!gets_a_mesh) {
      throw Error(ErrorKind::Usage,
                  fmt::format("'{}': slot {} is no blank slot of '{}' in the range asked for", options.points,
                              slot, options.input));
    }
  }
  return booth;
}

/// What tells one computation of depth maps from another.
std::string made_of(const take::TakeReader& take, const pipeline::BoothConfig& booth,
                    const pipeline::BoothParts& stages, const Options& options) {
  capture::Rig rig = *stages.rig;
  rig.lights.clear();  // depth does without
  nlohmann::ordered_json text = {
      {"take", take.info().source},
      {"created_utc", take.info().created_utc},
      {"first_timestamp_ns", take.info().first_timestamp_ns},
      {"slots", options.frames},
      {"nearest_mm", stages.depth->depths().nearest_mm},
      {"farthest_mm", stages.depth->depths().farthest_mm},
      {"program", capture::to_text(booth.program)},
      {"blanks_per_run", stages.blanks_per_run},
      {"software", FACET_VERSION},
      {"rig", capture::format_rig(rig)},
  };
  if (booth.every_slot) {
    text["every_slot"] = true;
  }
  return text.dump(1) + "\n";
}

/// Gives the sets of some slots to what makes meshes of them, until all are through. Returns the signal that
/// broke it off, or 0. Throws what reading the take throws, once all that was read is through.
int run_to_end(pipeline::BoothMeshes& meshes, take::TakeReader& input, const std::vector<std::int64_t>& slots,
               const StopSignals& signals, const std::function<void()>& show) {
  meshes.start();
  // Reads ahead as far as the meshes let it.
  std::exception_ptr damage;
  std::jthread reading([&](const std::stop_token& broken_off) {
    try {
      for (auto slot = slots.begin(); slot != slots.end() && !broken_off.stop_requested(); ++slot) {
        if (auto set = input.frame(*slot)->images) {
          meshes.deliver(std::move(set));
        }
      }
    } catch (...) {
      damage = std::current_exception();
    }
    meshes.finish();
  });
  int broken_off_by = 0;
  while (!meshes.finished()) {
    if (const int signal = signals.wait(kPeriod); signal != 0) {
      broken_off_by = signal;
      reading.request_stop();
      meshes.request_stop();
    }
    show();
  }
  reading.request_stop();
  reading.join();
  meshes.stop();
  show();
  if (damage != nullptr && broken_off_by == 0) {
    std::rethrow_exception(damage);
  }
  return broken_off_by;
}

/// What a booth's take came to, where it came to nothing.
void check_booth_result(const Options& options, const pipeline::PipelineStatus& status) {
  if (status.state == pipeline::PipelineState::Failed) {
    throw Error(status.failure_kind, status.reason);
  }
  if (status.processed == 0) {
    throw Error(
        ErrorKind::UnreadableInput,
        fmt::format("'{}' has no blank slot with pictures in the range asked for: choose another with "
                    "--frames, or give the trigger's program with --config",
                    options.input));
  }
  if (status.mesh_frames == 0) {
    throw Error(ErrorKind::NoFace,
                fmt::format("no mesh in the {} slots of '{}' that were to get one; the last one because: {}",
                            status.processed, options.input, status.degraded_reason));
  }
}

/// Another member than the leader: finds depth maps, and nothing else.
void help_booth(const Options& options, Team& team, const StopSignals& signals) {
  service::Config config = configure(options);
  config.rig_file = options.rig;
  take::TakeReader input(options.input);
  const std::vector<std::int64_t> slots = slots_of(input, config.pipeline.frames);
  pipeline::BoothConfig booth = booth_of(options, config, input, slots);
  booth.shading = false;
  pipeline::BoothParts stages = pipeline::open_booth(booth, kBlanksPerRun);
  stages.tracker.reset();
  stages.depth = std::make_unique<SharedDepth>(std::move(stages.depth), team, nullptr);
  pipeline::BoothMeshes meshes(std::move(stages), pipeline::BoothMeshes::WhenBusy::Wait, {});
  try {
    if (run_to_end(meshes, input, slots, signals, [] {}) != 0) {
      team.abort(1);
    }
  } catch (const Error&) {
    // A damaged take is the leader's to tell: it meets the same damage.
  }
  const pipeline::PipelineStatus status = meshes.status();
  if (status.state == pipeline::PipelineState::Failed) {
    throw Error(status.failure_kind, status.reason);
  }
}

void lead_booth(const Options& options, Team& team, const StopSignals& signals) {
  service::Config config = configure(options);
  config.rig_file = options.rig;
  take::TakeReader input(options.input);
  const std::vector<std::int64_t> slots = slots_of(input, config.pipeline.frames);
  const pipeline::BoothConfig booth = booth_of(options, config, input, slots);
  const auto wanted =
      static_cast<std::uint64_t>(std::count_if(slots.begin(), slots.end(), [&](std::int64_t i) {
        return booth.every_slot || is_blank(booth.program, input.entry(i).sequence);
      }));
  pipeline::BoothParts stages = pipeline::open_booth(booth, kBlanksPerRun);
  std::shared_ptr<report::DepthFolder> folder;
  pipeline::BoothMeshes::DepthTaker keep;
  if (!options.depth.empty()) {
    folder = std::make_shared<report::DepthFolder>(options.depth, *stages.rig,
                                                   made_of(input, booth, stages, options));
    keep = [folder](std::uint64_t slot, std::span<const capture::DepthMap> maps) {
      folder->write(slot, maps);
    };
    if (!folder->kept().empty()) {
      tell(stderr, "facet: {} depth maps are in '{}' already and are taken from there\n",
           folder->kept().size(), options.depth);
    }
  }
  pipeline::TakeSink take;
  take.begin(recorder_of(options, config));
  stages.depth = std::make_unique<SharedDepth>(std::move(stages.depth), team, folder);
  pipeline::BoothMeshes meshes(std::move(stages), pipeline::BoothMeshes::WhenBusy::Wait, {&take},
                               std::move(keep));
  Progress progress("Processing", wanted, "meshes");
  pipeline::PipelineStatus status;
  const auto show = [&] {
    status = meshes.status();
    progress.set(status.processed, booth_note(status));
  };
  std::exception_ptr damage;
  int broken_off_by = 0;
  try {
    broken_off_by = run_to_end(meshes, input, slots, signals, show);
  } catch (...) {
    damage = std::current_exception();
  }
  progress.finish();
  const std::optional<take::RecorderStatus> written =
      take.end(broken_off_by != 0 ? "broken off by a signal" : "");
  if (broken_off_by != 0 && folder != nullptr) {
    tell(stderr, "facet: the depth maps found so far are kept in '{}': the same command goes on from there\n",
         options.depth);
  }
  conclude(options, status, written, meshes.take_messages(), broken_off_by, signals, [&] {
    if (damage != nullptr && status.mesh_frames == 0) {
      std::rethrow_exception(damage);
    }
    check_booth_result(options, status);
  });
  if (damage != nullptr) {
    std::rethrow_exception(damage);
  }
}

void run_booth(const Options& options, const std::function<std::unique_ptr<Team>()>& join) {
  const StopSignals signals;
  const std::unique_ptr<Team> joined = join();
  Team& team = *joined;
  try {
    team.leads() ? lead_booth(options, team, signals) : help_booth(options, team, signals);
  } catch (const Error& error) {
    if (team.size() == 1) {
      throw;
    }
    // The others wait for this one.
    tell(stderr, "facet: process {} of {}: {}\n", team.rank() + 1, team.size(), error.what());
    team.abort(static_cast<int>(error.kind()));
  } catch (const std::exception& error) {
    if (team.size() == 1) {
      throw;
    }
    tell(stderr, "facet: process {} of {}: {}\n", team.rank() + 1, team.size(), error.what());
    team.abort(static_cast<int>(ErrorKind::Internal));
  }
}

void add_booth_options(const Command& command, Options& options) {
  command
      .flag("--no-lights", options.no_lights,
            "Leave out what slots say that known lights lit (photometric stereo)")
      .needs("--rig");
  command
      .flag("--every-slot", options.every_slot,
            "A mesh for slots with patterns, too: between the blank ones' meshes, on its own depth maps")
      .needs("--rig");
  command
      .flag("--shading", options.shading,
            "Shading of the blank slots' colour pictures on top of what depth gives")
      .needs("--rig");
  command
      .option("--depth", options.depth,
              "Folder for the depth maps of every slot that gets a mesh (PFM, mm) and their lenses "
              "(rig.toml); maps that an "
              "earlier run left there are not found again")
      .needs("--rig");
  command
      .option("--program", options.program,
              "What the slots show in turn: fringes, stripes, or a word for each slot; "
              "default: what the slots say of themselves, else --config's trigger")
      .needs("--rig");
  command
      .option("--points", options.points,
              "Where the face is in one slot, pointed at by hand, if the landmark net does not find it "
              "(docs/booth.md)")
      .needs("--rig");
}

}  // namespace

Command add_process_command(Command app, std::unique_ptr<Team> (*join)()) {
  auto options = std::make_shared<Options>();
  const Command command = app.subcommand("process",
                                         "Turn a video of a face, videos of calibrated cameras that see it, "
                                         "or the pictures that a take or a booth recorded, "
                                         "into a take of meshes");
  command
      .option("input", options->inputs,
              "The video, or a take of one live camera that holds its pictures; with --rig the take that "
              "holds a booth's pictures, or one video for each of the "
              "rig's cameras that see the face, CAMERA=VIDEO (VIDEO alone where it bears the camera's name), "
              "the one that looks at it most squarely first")
      .required();
  command.option(
      "--rig", options->rig,
      "Rig file: the input is videos of its cameras; or a take of a booth's pictures, and every blank slot "
      "becomes a mesh");
  command.option("-o,--output", options->take, "The take to write, NAME.take; must not exist yet")
      .required()
      .ends_in({".take"});
  command.option("--config", options->config,
                 "Configuration file; of [source], only frames and intrinsics count");
  command.option("--frames", options->frames, kFramesHelp);
  command.option(
      "--person", options->person,
      "Who is to be seen: the name of somebody in the folder of persons ([persons] of --config or of the "
      "installed configuration), or a file that facet enrol wrote (it has a slash or ends in .person); that "
      "shape is followed instead of a guess from the first frames");
  command.flag(
      "--live", options->live,
      "Follow the guess of the first good frames, as with a live camera: do not look at the recording's "
      "first 3000 frames to learn the face's own shape where its head turns");
  command.option("--budget", options->budget,
                 "Solver work per frame: \"auto\" (as many steps as pay), \"paper\" (10 of 7 "
                 "iterations) or Gauss-Newton "
                 "steps per level");
  command
      .option(
          "--detail", options->detail,
          "What refinement errs towards: \"faithful\" (little relief that is not there) or \"expressive\" "
          "(the folds that one knows a person by, some of stubble and hair line with them); over --config's "
          "weights")
      .one_of({"faithful", "expressive"});
  command.option("--device", options->device,
                 "Vulkan device: auto, part of its name, or none (coarse meshes only)");
  add_booth_options(command, *options);
  command
      .option("--cameras", options->cameras,
              "Of a take of frame sets in plain light (mode \"frames\"): the cameras that see the face, "
              "NAME,NAME,..., the one that looks at it most squarely first. Their pictures are tracked "
              "and refined like videos, "
              "without depth maps")
      .delimiter(',')
      .one_at_a_time()
      .needs("--rig");
  command.footer(
      "Exit status 3 with a take written: the video or take is truncated or damaged, and what could be read "
      "of it is\nprocessed.");
  command.callback([options, join] {
    const bool videos = has_views(*options);
    const bool views = videos || !options->cameras.empty();
    if (videos && !options->cameras.empty()) {
      throw Error(ErrorKind::Usage,
                  "--cameras is for a take of frame sets; a video's camera is named as in NAME=VIDEO");
    }
    options->input = videos ? named_video(options->inputs.front()).file : options->inputs.front();
    if (views &&
        (options->every_slot || options->shading || !options->depth.empty() || !options->points.empty())) {
      throw Error(ErrorKind::Usage,
                  "--every-slot, --shading, --depth and --points are for the pictures of a booth, not for "
                  "videos and --cameras");
    }
    if (options->live && !options->rig.empty() && !views) {
      throw Error(ErrorKind::Usage, "--live is for videos of one camera, not for the pictures of a booth");
    }
    options->rig.empty() || views ? run_monocular(*options) : run_booth(*options, join);
  });
  return command;
}

void add_process_command(Command program) {
  add_process_command(program, join_nobody);
}

}  // namespace facet::tools
