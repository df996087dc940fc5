// `facet synth-booth`: what a booth would record of the virtual actor or a target, with the truth.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <system_error>

#include "actor_options.hpp"
#include "capture/rig_file.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "files/pfm.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "render/renderer.hpp"
#include "simulation/virtual_booth.hpp"
#include "take/recorder.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using nlohmann::json;
using simulation::BoothScene;
using simulation::BoothSlot;
using simulation::VirtualBooth;

constexpr std::array kScenes = {"actor", "plane", "sphere"};  // order of BoothScene

struct SynthBoothOptions {
  simulation::VirtualBoothConfig booth;
  std::string scene = kScenes[0];
  std::uint64_t first_slot = 150;
  std::uint64_t slots = 90;
  std::string meshes = "blank";
  bool quiet_sensor = false;
  std::string program = "fringes";
  std::vector<std::string> lamps;
  ActorChoice actor;
  std::string folder;
};

/// Red where the pixel shows skin, green where the pair's other camera sees the point too.
render::Picture mask_of(const simulation::DepthTruth& truth) {
  render::Picture mask = render::plain_picture(truth.width_px, truth.height_px, {0, 0, 0});
  for (std::size_t pixel = 0; pixel < truth.skin.size(); ++pixel) {
    mask.rgb[3 * pixel] = truth.skin[pixel] != 0 ? 255 : 0;
    mask.rgb[3 * pixel + 1] = truth.shared[pixel] != 0 ? 255 : 0;
  }
  return mask;
}

void write_truth(const VirtualBooth& booth, const BoothSlot& slot, const std::filesystem::path& folder,
                 bool with_mesh) {
  const std::string name = fmt::format("slot_{:06}", slot.number());
  for (const capture::StereoPair& pair : booth.rig().pairs) {
    const std::filesystem::path place = folder / booth.rig().cameras[pair.left].name;
    const simulation::DepthTruth truth = slot.depth(pair.left, pair.right);
    files::write_pfm({truth.width_px, truth.height_px, truth.depth_mm}, place / (name + ".pfm"));
    render::write_png(mask_of(truth), place / (name + ".png"));
  }
  if (with_mesh) {
    simulation::write_truth_ply(slot.surface(), folder / (name + ".ply"));
  }
}

std::shared_ptr<const mesh::MeshFrame> to_frame(FrameSet set, std::int64_t first_trigger_ns) {
  auto frame = std::make_shared<mesh::MeshFrame>();
  frame->sequence = set.slot;
  frame->timestamp_ns = set.trigger_ns;
  frame->media_time_ns = set.trigger_ns - first_trigger_ns;
  frame->control_vertices_mm.resize(3, 0);
  frame->images = std::make_shared<const FrameSet>(std::move(set));
  return frame;
}

json vector_json(const Eigen::Vector3d& vector) {
  return {vector.x(), vector.y(), vector.z()};
}

void write_description(const SynthBoothOptions& options, const VirtualBooth& booth) {
  const simulation::VirtualBoothConfig& config = booth.config();
  json document = {{"seed", config.seed},
                   {"scene", options.scene},
                   {"first_slot", options.first_slot},
                   {"slots", options.slots},
                   {"slots_per_second", config.slots_per_second},
                   {"exposure_ms", config.exposure_ms},
                   {"samples", config.samples},
                   {"resolution", config.resolution},
                   {"head_motion", config.head_motion},
                   {"ambient", config.ambient},
                   {"projector_blur_px", config.projector_blur_px},
                   {"sensor_noise", config.sensor_noise},
                   {"program", options.program},
                   {"gloss", config.gloss}};
  if (const auto target = booth.target()) {
    document["target"] = {{"centre_mm", vector_json(target->centre_mm)}};
    if (target->radius_mm > 0) {
      document["target"]["radius_mm"] = target->radius_mm;
    } else {
      document["target"]["normal"] = vector_json(target->normal);
    }
  }
  files::OutputFile output(std::filesystem::path(options.folder) / "booth.json");
  output.write(document.dump(1) + "\n");
  output.commit();
}

/// NAME=X,Y,Z[,STRENGTH]
capture::RigLight parse_lamp(const std::string& text) {
  capture::RigLight lamp;
  const std::size_t equals = text.find('=');
  lamp.name = text.substr(0, equals);
  const std::string numbers = equals == std::string::npos ? "" : text.substr(equals + 1);
  int used = 0;
  Eigen::Vector3d& at_mm = lamp.position_mm;
  bool sound = std::sscanf(numbers.c_str(), "%lf,%lf,%lf%n", &at_mm.x(), &at_mm.y(), &at_mm.z(), &used) == 3;
  const std::string rest = numbers.substr(static_cast<std::size_t>(used));
  if (sound && !rest.empty()) {
    sound = std::sscanf(rest.c_str(), ",%lf%n", &lamp.strength, &used) == 1 &&
            static_cast<std::size_t>(used) == rest.size();
  }
  if (!sound || lamp.name.empty() || !(lamp.strength >= 1e-3 && lamp.strength <= 1e3) ||
      !(at_mm.norm() < 1e5)) {
    throw Error(ErrorKind::Usage,
                fmt::format("--lamp {}: name it and say where it is, such as top=0,600,900", text));
  }
  return lamp;
}

void run_synth_booth(SynthBoothOptions options) {
  options.booth.scene =
      static_cast<BoothScene>(std::find(kScenes.begin(), kScenes.end(), options.scene) - kScenes.begin());
  options.booth.sensor_noise = !options.quiet_sensor;
  std::optional<face::FaceModel> model;
  if (options.booth.scene == BoothScene::Actor) {
    model = face::FaceModel::load(options.actor.model);
    options.booth.outside_span_mm = options.actor.outside_span_mm;
    options.booth.start_s = options.actor.start_s;
    options.booth.curves = read_curves(options.actor);
  }
  for (const std::string& lamp : options.lamps) {
    options.booth.lights.push_back(parse_lamp(lamp));
  }
  const capture::SlotProgram program = capture::parse_slot_program(options.program);
  const VirtualBooth booth(model ? &*model : nullptr, options.booth);
  const std::filesystem::path folder = options.folder;
  for (const capture::StereoPair& pair : booth.rig().pairs) {
    files::make_folder(folder / "truth" / booth.rig().cameras[pair.left].name);
  }
  take::TakeRecorderConfig config;
  config.file = folder / "capture.take";
  config.source = fmt::format("virtual booth, {}, seed {}", options.scene, options.booth.seed);
  config.software = "facet " FACET_VERSION;
  config.when_full = take::WhenFull::Wait;
  config.queue_frames = 4;
  config.with_images = true;
  take::TakeRecorder recorder(config);  // first: an earlier take stays with its files
  capture::write_rig(booth.rig(), folder / "rig.toml");
  write_description(options, booth);
  recorder.start();
  Progress progress("Rendering", options.slots, "slots");
  std::int64_t first_trigger_ns = 0;
  for (std::uint64_t k = 0; k < options.slots; ++k) {
    const BoothSlot slot = booth.slot(options.first_slot + k, program);
    const capture::SlotLight& light = capture::light_of_slot(program, slot.number());
    if (k == 0) {
      first_trigger_ns = slot.trigger_ns();
    }
    FrameSet set = slot.frame_set();
    set.light = capture::to_word(light);
    if (!recorder.record(to_frame(std::move(set), first_trigger_ns))) {
      break;  // stop() says why
    }
    const bool blank = light.kind == capture::SlotLight::Kind::Blank;
    write_truth(booth, slot, folder / "truth",
                options.meshes == "all" || (options.meshes == "blank" && blank));
    progress.advance();
  }
  const take::RecorderStatus status = recorder.stop();
  progress.finish();
  if (status.state != take::RecorderState::Finished || status.frames != options.slots) {
    throw Error(ErrorKind::Storage,
                fmt::format("{}: {} of {} slots were recorded: {}", config.file.string(), status.frames,
                            options.slots, status.reason.empty() ? "the recorder ended" : status.reason));
  }
  tell("{}: {} slots of {} cameras in capture.take, rig.toml, depth maps of the pairs in truth/\n",
       options.folder, options.slots, booth.rig().cameras.size());
}

}  // namespace

void add_synth_booth_command(Command app) {
  auto options = std::make_shared<SynthBoothOptions>();
  const Command command = app.subcommand(
      "synth-booth", "Render what a booth of six cameras and two projectors would record, with true depth");
  command.option("--seed", options->booth.seed, "Rig, actor, performance and noise follow from it")
      .shows_default();
  command.option("--scene", options->scene, "actor: performs; plane, sphere: still targets")
      .shows_default()
      .one_of({kScenes.begin(), kScenes.end()});
  command.option("--slots", options->slots, "Number of slots, 60 a second").shows_default().range(1, 36'000);
  command
      .option("--first-slot", options->first_slot,
              "The actor begins calmly: by slot 150 the head moves as it does later")
      .shows_default()
      .range(0, 36'000);
  command
      .option("--resolution", options->booth.resolution,
              "Of the cameras: 1 is 640x480 px, 0.5 is 320x240, a quarter of the work")
      .shows_default()
      .range(0.25, 4.0);
  command.option("--exposure", options->booth.exposure_ms, "Of all cameras, ms; 0: nothing blurs")
      .shows_default();
  command.option("--samples", options->booth.samples, "Rays a pixel, spread over the exposure")
      .shows_default()
      .range(1, 64);
  command
      .option("--head-motion", options->booth.head_motion,
              "0: the head is still, 1: it turns by up to 25 degrees")
      .shows_default();
  command.option("--ambient", options->booth.ambient, "Room light, of the projectors' white").shows_default();
  command
      .option("--program", options->program,
              "What the slots show in turn: fringes, stripes, or a word for each slot (docs/booth.md); "
              "light:projector-l shows that projector's white alone")
      .shows_default();
  command.option("--lamp", options->lamps,
                 "A lamp for slots such as light:top, as NAME=X,Y,Z[,STRENGTH]: mm from the face's middle, x "
                 "to its left, y up, z to the cameras; STRENGTH in a projector's white (1)");
  command.option("--gloss", options->booth.gloss, "Skin's mirrored light, 0.04 as dry skin's; 0: matt")
      .shows_default()
      .range(0.0, 0.2);
  command.flag("--quiet-sensor", options->quiet_sensor, "No noise");
  command.option("--meshes", options->meshes, "Slots whose surface is written, 12 MB each")
      .shows_default()
      .one_of({"all", "blank", "none"});
  add_actor_options(command, options->actor);
  command.option("-o,--output", options->folder, "Folder to write into").required();
  command.callback([options] { run_synth_booth(*options); });
}

}  // namespace facet::tools
