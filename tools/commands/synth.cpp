// `facet synth`: sequences of the virtual actor with known geometry.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "actor_options.hpp"
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
  std::string burst;
  ActorChoice actor;
  std::optional<std::uint64_t> frames;
  std::string camera = "clean";
  simulation::SequenceFiles files;
  std::string skin = "painted";
  std::string without;
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
  constexpr double kActed_s = 10.0 / 3;
  const bool is_take = std::filesystem::path(options.folder).extension() == ".take";
  if (!options.burst.empty()) {
    options.studio.burst = simulation::parse_burst(options.burst);
  }
  const bool bursts = options.studio.burst != simulation::Burst::None;
  if (bursts && (is_take || options.light == "strobe")) {
    throw Error(ErrorKind::Usage, "--burst is of a video, whose light is not a strobe");
  }
  const double turn_s = simulation::kCalmTurn_s + (bursts ? simulation::kBurst_s : 0);
  const double duration_s = options.studio.calm_turn ? turn_s : kActed_s;
  options.studio.frame_count = static_cast<int>(
      options.frames.value_or(static_cast<std::uint64_t>(std::lround(duration_s * options.studio.rate_hz))));
  if (is_take) {
    write_take(face::FaceModel::load(options.actor.model), options);
    return;
  }
  const PictureSize size = parse_picture_size("--size", options.size);
  options.studio.width_px = size.width_px;
  options.studio.height_px = size.height_px;
  options.studio.light = simulation::parse_light(options.light);
  options.studio.look.skin_type = simulation::parse_skin_type(options.skin);
  options.studio.look = simulation::without(options.studio.look, options.without);
  options.studio.outside_span_mm = options.actor.outside_span_mm;
  options.studio.start_s = options.actor.start_s;
  options.studio.curves = read_curves(options.actor);
  options.studio.webcam = simulation::parse_webcam_effects(options.camera);
  const face::FaceModel model = face::FaceModel::load(options.actor.model);
  const simulation::ActorSequence studio(model, options.studio);
  Progress progress("Rendering", static_cast<std::uint64_t>(options.studio.frame_count));
  simulation::write_sequence(studio, options.folder, options.files,
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
  command.option("--person", options->studio.person,
                 "Who the actor is, whatever the seed: the same person in another performance and light");
  command
      .option("--frames", options->frames,
              "Number of frames at 30 per second; default: 100, of a calm turn its 10 s")
      .range(1, 1'000'000);
  command.option("--size", options->size, "WIDTHxHEIGHT in pixels").shows_default();
  command
      .option(
          "--light", options->light,
          "sh: distant, smooth; area: lamps with soft shadows; lamps: small near ones; window; ring: round "
          "the camera; strobe: one of six in turn")
      .shows_default()
      .one_of(simulation::light_names());
  command.flag("--highlights", options->studio.highlights, "The painted skin shines");
  command
      .option(
          "--skin", options->skin,
          "painted; or made of melanin and blood, with strands for hair: a Fitzpatrick type, 1 (palest) to "
          "6, or any: one that follows from the seed")
      .shows_default();
  command.option("--without", options->without,
                 fmt::format("Of a skin that is not painted: leave out some of {}",
                             fmt::join(simulation::look_effects(), ",")));
  command.flag("--glasses", options->studio.glasses, "The actor wears spectacles");
  command
      .option("--turn", options->studio.turn_deg,
              "Of a video: the head also turns by so many degrees and back, while the actor acts")
      .range(-90.0, 90.0)
      .shows_default();
  command.flag(
      "--calm-turn", options->studio.calm_turn,
      "Of a video: instead of acting the head turns by 30 degrees to both sides and by 10 up and down, "
      "in 10 s, the face at rest but for blinks");
  command
      .option("--burst", options->burst,
              "After the calm turn four lights fire in turn, for 1.5 s in which the head is still. lamps: "
              "small ones about the camera; screen: the halves of a screen below it, left, right, upper and "
              "lower; dim-screen: the same in a dim room")
      .one_of({"lamps", "screen", "dim-screen"})
      .needs("--calm-turn");
  command
      .option("--cameras", options->studio.camera_count,
              "Of a video: so many calibrated cameras see the actor, the first one as without this; one "
              "video each and rig.toml")
      .shows_default()
      .range(1, 8);
  command.option("--spread", options->studio.spread_deg, "Degrees from one of those cameras to the next")
      .shows_default()
      .range(1.0, 60.0);
  command
      .option(
          "--camera", options->camera,
          "Of a video: clean; webcam: all of what follows with h264; or some of them, with commas between: "
          "h264 or mjpeg, exposure, white-balance, rolling-shutter, motion-blur, distortion")
      .shows_default();
  add_actor_options(command, options->actor);
  command
      .option("--truth-every", options->files.truth_every,
              "Of a video: a truth mesh (12 MB) for every so many frames")
      .shows_default()
      .range(1, 1000);
  command.flag(
      "--surfaces", options->files.with_surfaces,
      "Of a video: also surfaces/, all that is seen in every frame but strands, for other renderers");
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
