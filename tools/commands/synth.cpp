// `facet synth`: sequences of the virtual actor with known geometry.

#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <string>

#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "options.hpp"
#include "picture_size.hpp"
#include "progress.hpp"
#include "simulation/actor_take.hpp"
#include "simulation/sequence.hpp"
#include "take/recorder.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct SynthOptions {
  simulation::ActorSequenceConfig studio;
  std::string size = "1280x720";
  std::string light = "sh";
  std::string model = default_model_file().string();
  std::string folder;
  std::int32_t max_vertices = simulation::ActorTakeConfig{}.max_vertices;
};

/// The actor's meshes alone, as a take.
void write_take(const face::FaceModel& model, const SynthOptions& options) {
  const simulation::ActorTake actor(
      model, {options.studio.seed, options.studio.frame_count, options.studio.rate_hz, options.max_vertices});
  take::TakeRecorderConfig config;
  config.file = options.folder;
  config.source = fmt::format("virtual actor {}", options.studio.seed);
  config.software = fmt::format("facet synth {}", FACET_VERSION);
  config.when_full = take::WhenFull::Wait;
  take::TakeRecorder recorder(config);
  recorder.start();
  Progress progress("Performing", static_cast<std::uint64_t>(options.studio.frame_count));
  for (int index = 0; index < actor.frame_count(); ++index) {
    recorder.record(actor.frame(index));
    progress.advance();
  }
  const take::RecorderStatus status = recorder.stop();
  progress.finish();
  if (status.state == take::RecorderState::Failed) {
    throw Error(ErrorKind::Storage, fmt::format("'{}': {}", options.folder, status.reason));
  }
  tell("{}: {} meshes of {} vertices\n", options.folder, status.mesh_frames,
       actor.subject().hierarchy->finest().vertex_count);
}

void run_synth(SynthOptions options) {
  if (std::filesystem::path(options.folder).extension() == ".take") {
    write_take(face::FaceModel::load(options.model), options);
    return;
  }
  const PictureSize size = parse_picture_size("--size", options.size);
  options.studio.width_px = size.width_px;
  options.studio.height_px = size.height_px;
  options.studio.light =
      options.light == "area" ? simulation::LightKind::Area : simulation::LightKind::SphericalHarmonics;
  const face::FaceModel model = face::FaceModel::load(options.model);
  const simulation::ActorSequence studio(model, options.studio);
  Progress progress("Rendering", static_cast<std::uint64_t>(options.studio.frame_count));
  simulation::write_sequence(studio, options.folder,
                             [&](int done) { progress.set(static_cast<std::uint64_t>(done)); });
  progress.finish();
  if (options.studio.camera_count > 1) {
    tell("{}: {} cameras, rig.toml\n", options.folder, options.studio.camera_count);
  }
  tell(
      "{}: {} frames of {}x{} px, truth in truth/, camera.json; the actor differs from the model's span by "
      "{:.2f} mm (rms)\n",
      options.folder, options.studio.frame_count, options.studio.width_px, options.studio.height_px,
      studio.outside_span_rms_mm());
}

}  // namespace

void add_synth_command(Command app) {
  auto options = std::make_shared<SynthOptions>();
  const Command command = app.subcommand(
      "synth", "Render a sequence of a virtual actor with known geometry (video, truth meshes, camera)");
  command.option("--seed", options->studio.seed, "Actor, performance, camera and light follow from it")
      .shows_default();
  command.option("--frames", options->studio.frame_count, "Number of frames at 30 per second")
      .shows_default()
      .range(1, 1'000'000);
  command.option("--size", options->size, "WIDTHxHEIGHT in pixels").shows_default();
  command.option("--light", options->light, "sh: distant, smooth; area: lamps with soft shadows")
      .shows_default()
      .one_of({"sh", "area"});
  command.flag("--highlights", options->studio.highlights, "The skin shines");
  command.flag("--glasses", options->studio.glasses, "The actor wears spectacles");
  command
      .option("--turn", options->studio.turn_deg,
              "Of a video: the head also turns by so many degrees and back")
      .range(-90.0, 90.0)
      .shows_default();
  command
      .option("--cameras", options->studio.camera_count,
              "Of a video: so many calibrated cameras see the actor, the first one as without this; one "
              "video each and rig.toml")
      .shows_default()
      .range(1, 8);
  command.option("--spread", options->studio.spread_deg, "Degrees from one of those cameras to the next")
      .shows_default()
      .range(1.0, 60.0);
  command.option("--model", options->model, "Face model file whose topology the actor uses").shows_default();
  command.option("--vertices", options->max_vertices, "Of a take's finest meshes, at most")
      .shows_default()
      .range(1'000, 200'000);
  command
      .option(
          "-o,--output", options->folder,
          "Folder to write into; or NAME.take: the actor's meshes alone, as a tracker without error would "
          "make them")
      .required();
  command.callback([options] { run_synth(*options); });
}

}  // namespace facet::tools
