// `facet doctor`: looks at everything that the daemon needs and says what is wrong and what to do.

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "avatar/bridge.hpp"
#include "avatar/mapping_file.hpp"
#include "avatar/vrchat.hpp"
#include "avatar/vrchat_finder.hpp"
#include "booth/booth_depth.hpp"
#include "camera/factory.hpp"
#include "camera/host_sandbox.hpp"
#include "camera/video_file.hpp"
#include "capture/rig_file.hpp"
#include "face/face_model.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "gpu/context.hpp"
#include "gpu/driver_files.hpp"
#include "gpu/facts.hpp"
#include "landmark/landmark_assets.hpp"
#include "options.hpp"
#include "pipeline/frames.hpp"
#include "pipeline/lamp_burst.hpp"
#include "pipeline/live_cameras.hpp"
#include "render/embree.hpp"
#include "service/config.hpp"
#include "service/control_client.hpp"
#include "service/default_paths.hpp"
#include "stream/unix_socket.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

enum class Verdict { Good, Note, Bad };

/// Prints one finding a line and remembers the first fault's kind, which becomes the exit status.
class Report {
 public:
  void say(Verdict verdict, const std::string& what, const std::string& finding,
           const std::string& advice = {}) {
    const char* mark = verdict == Verdict::Good ? "ok  " : verdict == Verdict::Note ? "note" : "BAD ";
    tell("{}  {:<16} {}\n", mark, what, finding);
    if (!advice.empty()) {
      tell("      {:<16} -> {}\n", "", advice);
    }
  }
  void bad(ErrorKind kind, const std::string& what, const std::string& finding,
           const std::string& advice = {}) {
    say(Verdict::Bad, what, finding, advice);
    ++faults_;
    if (!first_fault_) {
      first_fault_ = kind;
    }
  }
  int faults() const { return faults_; }
  std::optional<ErrorKind> first_fault() const { return first_fault_; }

 private:
  int faults_ = 0;
  std::optional<ErrorKind> first_fault_;
};

void check_vulkan(Report& report, const std::string& wanted) {
  if (wanted == pipeline::kNoDevice) {
    report.say(Verdict::Note, "Vulkan", "not used: gpu.device is \"none\"",
               "meshes stay coarse; set gpu.device = \"auto\" for refinement");
    return;
  }
  try {
    const std::vector<gpu::DeviceInfo> devices = gpu::list_devices();
    for (const gpu::DeviceInfo& device : devices) {
      report.say(device.usable ? Verdict::Good : Verdict::Note, "Vulkan device",
                 fmt::format("{} ({}, {}){}", device.name, gpu::describe(device.type), device.driver,
                             device.usable ? "" : ": not usable: " + device.why_unusable));
    }
    for (const std::string& lack :
         devices.empty() ? std::vector<std::string>() : gpu::what_gpus_lack(devices)) {
      report.say(Verdict::Note, "Vulkan", lack);
    }
    gpu::Context context({.device = wanted});
    if (const std::string ignored = context.kernel_cache().ignored; !ignored.empty()) {
      report.say(Verdict::Note, "Vulkan", ignored, "they are compiled anew and the file is replaced");
    }
    const gpu::DeviceFacts facts = gpu::device_facts(context);
    const std::uint64_t heap_bytes = facts.heap_bytes.empty() ? 0 : std::ranges::max(facts.heap_bytes);
    report.say(Verdict::Good, "Vulkan",
               fmt::format("\"{}\" opens {} (Vulkan {}, {:.1f} GiB)", wanted, context.info().name,
                           facts.api_version, static_cast<double>(heap_bytes) / (1U << 30U)),
               context.info().is_software ? "this is a software device: refinement is slow; a GPU with a "
                                            "Vulkan 1.2 driver makes it real-time"
                                          : "");
  } catch (const Error& error) {
    report.bad(error.kind(), "Vulkan", error.what());
  }
}

void check_model(Report& report, const service::Config& config) {
  try {
    const auto model = face::FaceModel::load(config.pipeline.model_file);
    report.say(
        Verdict::Good, "face model",
        fmt::format("{}: {} vertices, {} identity modes, {} expressions", config.pipeline.model_file.string(),
                    model.vertex_count(), model.identity_count(), model.expression_count()));
    if (model.landmarks.empty()) {
      report.bad(ErrorKind::UnreadableInput, "face model", "has no landmark map",
                 "facet model landmarks MODEL");
    }
  } catch (const Error& error) {
    report.bad(error.kind(), "face model", error.what(),
               fmt::format("facet model build -o {}", config.pipeline.model_file.string()));
  }
  try {
    landmark::LandmarkAssets::load(config.pipeline.tracker.landmark_nets);
    report.say(Verdict::Good, "landmark nets", config.pipeline.tracker.landmark_nets.string());
  } catch (const Error& error) {
    report.bad(error.kind(), "landmark nets", error.what());
  }
}

/// What is opened only where it is needed.
void check_libraries(Report& report, const service::Config& config) {
  try {
    camera::require_ffmpeg();
    report.say(Verdict::Good, "FFmpeg", "its libraries open: videos of all kinds are read and written");
  } catch (const Error& error) {
    report.say(Verdict::Note, "FFmpeg", error.what(),
               "until then only Motion JPEG in AVI is read, and no video is written");
  }
  try {
    render::require_embree();
    report.say(Verdict::Good, "Embree", "its library opens: pictures of meshes are drawn");
  } catch (const Error& error) {
    if (config.mode == service::Mode::Booth) {
      report.bad(error.kind(), "Embree", error.what());
    } else {
      report.say(Verdict::Note, "Embree", error.what(), "until then no pictures of meshes are drawn");
    }
  }
}

/// The cameras of this machine.
void list_cameras(Report& report) {
  for (const camera::CameraKind* kind : camera::camera_kinds()) {
    try {
      for (const camera::FoundCamera& found :
           kind->list != nullptr ? kind->list() : std::vector<camera::FoundCamera>()) {
        report.say(Verdict::Note, "camera", found.text);
        if (!found.controls.empty()) {
          report.say(Verdict::Note, "controls", found.controls);
        }
      }
    } catch (const Error& error) {
      report.say(Verdict::Note, "camera", error.what());
    }
  }
  if (const std::string unguarded = camera::files_unguarded(); !unguarded.empty()) {
    report.say(Verdict::Note, "containment", unguarded,
               "a camera's process can read and write all files of the daemon's user until it has");
  }
}

/// One camera that is open: what it is, or why it does not work.
void say_open(Report& report, const std::string& what, const Camera& camera, const std::string& key) {
  const CameraInfo info = camera.info();
  const CameraStatus status = camera.status();
  if (status.state == CameraState::Idle) {
    report.say(
        Verdict::Good, what,
        fmt::format("{}: {}x{} px at {:.3g} Hz", info.name, info.width_px, info.height_px, info.rate_hz));
    return;
  }
  report.bad(ErrorKind::Unavailable, what, status.reason,
             status.state == CameraState::Absent
                 ? fmt::format("plug the camera in, or set {}; facetd waits for it", key)
                 : "facetd tries again until it works");
}

/// Takes the lines for a moment, unless the daemon has them.
void check_trigger(Report& report, const pipeline::Devices& devices, bool daemon_runs) {
  const pipeline::DevicesConfig& config = devices.config;
  if (!devices.open_trigger) {
    report.say(Verdict::Good, "trigger", "none: the cameras run freely");
    return;
  }
  const std::string program = fmt::format("{} lines, {:.4g} slots a second", config.program.lines.size(),
                                          config.program.slots_per_second);
  if (daemon_runs) {
    report.say(Verdict::Note, "trigger", program + "; the daemon has the lines: see facet status");
    return;
  }
  try {
    devices.open_trigger();
    report.say(Verdict::Good, "trigger", program + "; they can be had");
  } catch (const Error& error) {
    report.bad(error.kind(), "trigger", error.what(), "facetd tries again until it works");
  }
}

/// The same of a kiosk's lamps, which stay off.
void check_lamps(Report& report, const service::Config& config) {
  const pipeline::LampsConfig& lamps = config.pipeline.lamps;
  if (lamps.outputs.empty()) {
    return;
  }
  const std::string what = fmt::format("{} on chip {}", lamps.outputs.size(), lamps.outputs.front().chip);
  std::error_code ignored;
  if (std::filesystem::exists(config.control.socket, ignored)) {
    report.say(Verdict::Note, "lamps", what + "; the daemon has the lines");
    return;
  }
  try {
    pipeline::open_lamps(lamps);
    report.say(Verdict::Good, "lamps", what + "; their lines can be had",
               lamps.each_ms < pipeline::LampsConfig::kLeastCalm_ms
                   ? "they change more than three times a second, which can harm people who are sensitive to "
                     "flicker: lamps.each_ms = 400 does not"
                   : "");
  } catch (const Error& error) {
    report.bad(error.kind(), "lamps", error.what(), "correct [lamps], or leave it out");
  }
}

void check_devices(Report& report, const service::Config& config) {
  std::error_code ignored;
  const bool daemon_runs = std::filesystem::exists(config.control.socket, ignored);
  try {
    const pipeline::Devices devices = pipeline::open_devices(config.devices);
    for (std::size_t i = 0; i < devices.cameras.size(); ++i) {
      say_open(report, "camera " + config.devices.cameras[i].name, *devices.cameras[i], "its device");
    }
    check_trigger(report, devices, daemon_runs);
    if (service::has_live_cameras(config)) {
      const auto known = pipeline::calibration_of(config.devices, config.rig_file);
      for (std::size_t i = 0; i < known.size(); ++i) {
        capture::check_size(devices.cameras[i]->info(), known[i], config.rig_file);
      }
      report.say(Verdict::Good, "rig file",
                 fmt::format("{}: has all cameras; meshes are in the frame of '{}'", config.rig_file.string(),
                             known.front().name));
    }
  } catch (const Error& error) {
    report.bad(error.kind(), "cameras", error.what());
  }
}

/// Whether the booth's calibration fits its devices.
void check_rig_file(Report& report, const service::Config& config) {
  try {
    const capture::Rig rig = capture::read_rig(config.rig_file);
    for (const capture::RigCamera& camera : rig.cameras) {
      const auto& devices = config.devices.cameras;
      if (std::none_of(devices.begin(), devices.end(),
                       [&](const auto& device) { return device.name == camera.name; })) {
        report.bad(ErrorKind::Usage, "rig file",
                   fmt::format("its camera '{}' is not among the configuration's", camera.name),
                   "give the [[camera]]s the names that they were calibrated under");
      }
    }
    const stereo::DepthRange depths =
        config.booth_depths.farthest_mm > 0 ? config.booth_depths : booth::depth_range(rig);
    report.say(Verdict::Good, "rig file",
               fmt::format("{}: {} cameras, {} pairs; the face is looked for from {:.0f} to {:.0f} mm",
                           config.rig_file.string(), rig.cameras.size(), rig.pairs.size(), depths.nearest_mm,
                           depths.farthest_mm));
  } catch (const Error& error) {
    report.bad(error.kind(), "rig file", error.what(), "facet calibrate (docs/calibration.md)");
  }
}

void check_source(Report& report, const service::Config& config) {
  const camera::CameraConfig& source = config.pipeline.source;
  if (!camera::names_source(source)) {
    report.say(Verdict::Note, "source", "none is configured",
               fmt::format("set source.{} in the configuration", camera::camera_kind(source.kind).needs));
    return;
  }
  try {
    say_open(report, "source", *camera::open_camera(config.pipeline.source), "source.device");
  } catch (const Error& error) {
    report.bad(error.kind(), "source", error.what());
  }
}

/// One target: who of this machine hears what is sent there.
void check_target(Report& report, const avatar::BridgeTarget& target) {
  const std::string what = avatar::to_string(target.protocol);
  avatar::LookedUp found{avatar::socket_address(target.address, target.port), ""};
  if (found.address.length == 0) {
    found = avatar::look_up_host(target);
  }
  if (found.address.length == 0) {
    report.say(Verdict::Note, what, fmt::format("{}: {}", target.text(), found.trouble),
               "facetd looks the name up every 30 s; until it is found the target gets nothing");
    return;
  }
  const bool is_tcp = avatar::kBridgeProtocols.at(static_cast<std::size_t>(target.protocol)).is_tcp;
  switch (avatar::who_listens(found.address, is_tcp)) {
    case avatar::Listener::Somebody:
      report.say(Verdict::Good, what, fmt::format("{}: a program listens there", target.text()),
                 target.protocol == avatar::BridgeProtocol::Vmc
                     ? "an avatar of which only the head moves wants bridges.vmc_shapes = \"presets\""
                     : "");
      break;
    case avatar::Listener::Nobody:
      report.say(Verdict::Note, what, fmt::format("{}: nothing listens there", target.text()),
                 "start the receiver and switch its receiving on; its port must be this one");
      break;
    case avatar::Listener::OtherMachine:
      report.say(Verdict::Note, what, fmt::format("{}: another machine, not looked at", target.text()),
                 "as a service facetd reaches it only with IPAddressAllow (docs/bridges.md)");
  }
}

/// VRChats of this machine and of its networks that answer in a while, configured or not.
void find_vrchats(Report& report, const avatar::BridgeConfig& bridges) {
  using namespace std::chrono_literals;
  avatar::VrChatFinder finder({.where = avatar::VrChatFind::Network, .patience = 1s});
  finder.start();
  std::this_thread::sleep_for(1500ms);
  const std::vector<avatar::FoundVrChat> found = finder.found();
  for (const avatar::FoundVrChat& vrchat : found) {
    const std::string avatar =
        vrchat.avatar == nullptr
            ? "does not tell what its avatar has"
            : fmt::format("avatar {} has {} parameters, {} of them are driven", vrchat.avatar->avatar,
                          vrchat.avatar->list.size(), avatar::VrChatWriter({}, vrchat.avatar.get()).driven());
    report.say(Verdict::Good, "vrchat",
               fmt::format("{} answers at {}: {}", vrchat.name, vrchat.target().text(), avatar),
               bridges.find.where == avatar::VrChatFind::Off
                   ? "[bridges] vrchat_find = \"machine\" sends to it"
                   : "");
  }
  if (found.empty() && bridges.find.where != avatar::VrChatFind::Off) {
    report.say(Verdict::Note, "vrchat", finder.fault().empty() ? "no VRChat answers" : finder.fault(),
               "start it, and switch OSC on in its menu: Options, OSC");
  }
}

void check_bridges(Report& report, const avatar::BridgeConfig& bridges) {
  for (const avatar::BridgeTarget& target : bridges.targets) {
    check_target(report, target);
  }
  for (const auto& [protocol, key, port, is_tcp] : avatar::kBridgeProtocols) {
    // VTube Studio's port is any that a program names; at iFacialMocap's, facetd itself may listen.
    const bool is_known =
        std::any_of(bridges.targets.begin(), bridges.targets.end(),
                    [wanted = protocol](const auto& target) { return target.protocol == wanted; });
    if (is_known || protocol == avatar::BridgeProtocol::VTubeStudio || !bridges.answer.empty()) {
      continue;
    }
    if (avatar::who_listens(avatar::socket_address("127.0.0.1", port), is_tcp) ==
        avatar::Listener::Somebody) {
      report.say(Verdict::Note, key,
                 fmt::format("a program listens at 127.0.0.1:{}, this protocol's usual port", port),
                 fmt::format("if it is a receiver: [bridges] {} = [\"127.0.0.1:{}\"]", key, port));
    }
  }
  if (!bridges.mapping_file.empty()) {
    try {
      const avatar::ValueMapping mapping = avatar::load_mapping(bridges.mapping_file);
      std::error_code ignored;
      const bool is_there = std::filesystem::exists(bridges.mapping_file, ignored);
      report.say(is_there ? Verdict::Good : Verdict::Note, "mapping",
                 is_there ? fmt::format("{}: {} values for VMC, {} for VRChat", bridges.mapping_file.string(),
                                        mapping.vmc.size(), mapping.vrchat.size())
                          : fmt::format("{} is not there: nothing is mapped until something is saved",
                                        bridges.mapping_file.string()));
    } catch (const Error& error) {
      report.bad(error.kind(), "mapping", error.what());
    }
  }
}

void check_takes(Report& report, const service::Config& config) {
  const std::filesystem::path& folder = config.takes.folder;
  std::error_code error;
  if (!std::filesystem::is_directory(folder, error)) {
    report.bad(
        ErrorKind::Storage, "takes", fmt::format("{} is not a folder", folder.string()),
        fmt::format("create it for the daemon's user, or set takes.folder: mkdir -p {}", folder.string()));
    return;
  }
  if (::access(folder.c_str(), W_OK | X_OK) != 0) {
    report.bad(ErrorKind::Storage, "takes", fmt::format("{} can't be written by this user", folder.string()),
               "run as the daemon's user, or change the folder's owner");
    return;
  }
  const auto space = std::filesystem::space(folder, error);
  if (error) {
    report.bad(ErrorKind::Storage, "takes", fmt::format("{}: {}", folder.string(), error.message()));
    return;
  }
  const std::string free =
      fmt::format("{}: {:.1f} GB free", folder.string(), static_cast<double>(space.available) / 1e9);
  if (space.available <= config.takes.disk_reserve_bytes) {
    report.bad(ErrorKind::Storage, "takes", free,
               fmt::format("recording stops at takes.disk_reserve ({:.1f} GB): free some space",
                           static_cast<double>(config.takes.disk_reserve_bytes) / 1e9));
  } else {
    report.say(Verdict::Good, "takes", free);
  }
}

void check_daemon(Report& report, const service::Config& config) {
  std::error_code error;
  for (const auto& [name, socket] :
       {std::pair{"stream socket", config.stream.socket}, {"control socket", config.control.socket}}) {
    const std::filesystem::path folder = socket.parent_path();
    if (!std::filesystem::exists(socket, error)) {
      if (std::filesystem::is_directory(folder, error)) {
        report.say(Verdict::Note, name,
                   fmt::format("{} is not there: the daemon does not run", socket.string()),
                   "systemctl start facetd, or facetd --config FILE");
      } else {
        report.bad(ErrorKind::Storage, name, fmt::format("its folder {} does not exist", folder.string()),
                   "create it, or set another path in the configuration");
      }
      continue;
    }
    try {
      stream::connect_unix(socket);
      report.say(Verdict::Good, name, fmt::format("{} answers", socket.string()));
    } catch (const Error& failure) {
      report.bad(failure.kind(), name, failure.what());
    }
  }
  if (std::filesystem::exists(config.control.socket, error)) {
    try {
      const nlohmann::json status =
          service::ControlClient(config.control.socket).call("status", nlohmann::json::object());
      report.say(Verdict::Good, "daemon", fmt::format("state {}", status.value("state", "unknown")));
    } catch (const Error& failure) {
      report.bad(failure.kind(), "daemon", failure.what());
    }
  }
}

void run(const std::string& given_file) {
  const std::string config_file = given_file.empty() ? service::installed_config_file() : given_file;
  Report report;
  service::Config config = service::default_config();
  if (!config_file.empty()) {
    try {
      config = service::load_config(config_file);
      report.say(Verdict::Good, "configuration", config_file);
    } catch (const Error& error) {
      report.bad(error.kind(), "configuration", error.what(), "the rest is checked with the defaults");
    }
  } else {
    report.say(Verdict::Note, "configuration", "none given: the defaults are checked",
               "facet doctor --config FILE");
  }
  report.say(Verdict::Good, "processor",
             fmt::format("{} cores", std::max(1U, std::thread::hardware_concurrency())));
  check_libraries(report, config);
  list_cameras(report);
  if (config.mode != service::Mode::Monocular || service::has_live_cameras(config)) {
    check_devices(report, config);
  }
  if (config.mode == service::Mode::Booth) {
    check_vulkan(report, config.pipeline.gpu_device);
    check_model(report, config);
    check_rig_file(report, config);
  } else if (config.mode == service::Mode::Monocular) {
    check_vulkan(report, config.pipeline.gpu_device);
    check_model(report, config);
    if (!service::has_live_cameras(config)) {
      check_source(report, config);
    }
    check_lamps(report, config);
  }
  check_takes(report, config);
  check_bridges(report, config.bridges);
  find_vrchats(report, config.bridges);
  check_daemon(report, config);
  if (report.first_fault()) {
    throw Error(*report.first_fault(),
                fmt::format("doctor found {} fault{}", report.faults(), report.faults() == 1 ? "" : "s"));
  }
  tell("\nEverything that was looked at is in order.\n");
}

}  // namespace

void add_doctor_command(Command app) {
  auto config_file = std::make_shared<std::string>();
  const Command command = app.subcommand(
      "doctor",
      "Check GPU, face model, cameras, trigger, receivers of bridges, sockets and disk; say what to do");
  command.option("--config", *config_file,
                 "The daemon's configuration file (default " + service::default_config_file().string() +
                     ", where it exists)");
  command.callback([config_file] { run(*config_file); });
}

}  // namespace facet::tools
