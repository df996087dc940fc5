#include "service/config.hpp"

#include <arpa/inet.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <optional>
#include <set>

#include "avatar/mapping_file.hpp"
#include "camera/v4l2_controls.hpp"
#include "facet/assets.hpp"
#include "facet/error.hpp"
#include "files/text_file.hpp"
#include "files/toml_section.hpp"
#include "mesh/arkit.hpp"
#include "person/person_folder.hpp"
#include "service/listen_address.hpp"
#include "service/settings.hpp"
#include "stream/protocol.hpp"
#include "stream/unix_socket.hpp"

namespace facet::service {
namespace {

using Section = files::TomlSection;
using Document = files::TomlDocument;

/// Settings of [expert.NAME]. Where they stood before, in [NAME], they still count.
template <std::size_t Count, typename Struct>
void read_expert(Section& section, Section expert, const std::string& name,
                 const Setting<Struct> (&settings)[Count], Struct& values) {
  expert.read(settings, values);
  expert.finish();
  section.read_moved(settings, values, fmt::format("[expert.{}]", name));
}

void read_intrinsics(Section section, std::optional<CameraIntrinsics>& intrinsics) {
  CameraIntrinsics given;
  section.read(kIntrinsicsSettings, given);
  section.finish();
  if (!section.given()) {
    return;
  }
  if (given.fx == 0 || given.fy == 0 || given.width_px == 0 || given.height_px == 0) {
    section.fail(section.node(), "fx", "a known camera needs fx, fy, cx, cy, width_px and height_px");
  }
  intrinsics = given;
}

/// Controls of a device by its driver's names for them.
void read_controls(Section section, std::vector<camera::ControlSetting>& controls) {
  std::set<std::string> keys;
  for (const auto& [name, node] : section.entries()) {
    const std::string key = camera::control_key(name);
    if (key.empty() || !keys.insert(key).second) {
      section.fail(node, name, key.empty() ? "is no name of a control" : "is set twice");
    }
    if (const auto number = node->value_exact<std::int64_t>()) {
      controls.push_back({name, *number});
    } else if (const auto on = node->value_exact<bool>()) {
      controls.push_back({name, *on});
    } else if (const auto text = node->value_exact<std::string>()) {
      controls.push_back({name, *text});
    } else {
      section.fail(node, name,
                   "must be true or false, a whole number, or the text of a menu's entry in quotes");
    }
  }
}

bool is_for_experts(const camera::CameraSetting& setting) {
  return std::any_of(
      std::begin(expert::kCamera), std::end(expert::kCamera),
      [&](const camera::CameraSetting& other) { return std::string_view(other.key) == setting.key; });
}

/// The settings of a source of its kind; those of other kinds are refused. What a camera can do is checked
/// when it is opened; here, what no camera can. left_out: a setting that this section does not have.
void read_settings(Section& section, camera::CameraConfig& source, std::string_view left_out = {}) {
  const camera::CameraKind& kind = camera::camera_kind(source.kind);
  const auto refuse = [&](const toml::node* node, const std::string& key, const auto& has) {
    std::vector<const char*> kinds;
    for (const camera::CameraKind* other : camera::camera_kinds()) {
      if (has(*other)) {
        kinds.push_back(other->name);
      }
    }
    section.fail(node, key,
                 fmt::format("is for kind = \"{}\"; the kind of this one is \"{}\"",
                             fmt::join(kinds, "\" or \""), source.kind));
  };
  std::set<std::string_view> seen = {left_out};
  for (const camera::CameraKind* other : camera::camera_kinds()) {
    for (const camera::CameraSetting& setting : other->settings) {
      const std::string_view key = setting.key;
      if (kind.find(key) != nullptr || !seen.insert(key).second) {
        continue;
      }
      if (const toml::node* node = section.find(setting.key, !is_for_experts(setting))) {
        refuse(node, setting.key, [&](const camera::CameraKind& one) { return one.find(key) != nullptr; });
      }
    }
  }
  for (const camera::CameraSetting& setting : kind.settings) {
    if (is_for_experts(setting)) {
      section.read_moved({&setting, 1}, source, "[expert.camera]");
    } else if (setting.key != left_out) {
      section.read(setting, source);
    }
  }
  Section controls = section.section("controls");
  if (controls.given() && !kind.has_controls) {
    refuse(controls.node(), "controls", [](const camera::CameraKind& one) { return one.has_controls; });
  }
  read_controls(std::move(controls), source.live.controls);
  if (kind.pair) {
    const auto& [one, other] = *kind.pair;
    if (kind.says(one, source) != kind.says(other, source)) {
      section.fail(section.node(), one, fmt::format("{} and {} need one another", one, other));
    }
  }
  if (source.turn.clockwise_deg % 90 != 0) {
    section.fail(section.find("turn"), "turn", "must be 0, 90, 180 or 270");
  }
}

void read_kind(Section& section, camera::CameraConfig& source) {
  std::vector<const char*> names;
  for (const camera::CameraKind* kind : camera::camera_kinds()) {
    names.push_back(kind->name);
  }
  if (const auto kind = section.read_choice("kind", names)) {
    source.kind = names[*kind];
  }
}

void read_source(Section section, Config& config) {
  pipeline::ShadingConfig& pipeline = config.pipeline;
  read_kind(section, pipeline.source);
  read_settings(section, pipeline.source);
  if (const toml::node* node = section.find("frames")) {
    try {
      pipeline.frames = pipeline::parse_frame_range(section.text(*node, "frames", files::kAnyText));
    } catch (const Error& error) {
      section.fail(node, "frames", error.what());
    }
  }
  section.read(kSourceSettings, config);
  read_intrinsics(section.section("intrinsics"), pipeline.tracker.intrinsics);
  section.finish();
}

/// Values that depend on one another are checked by pipeline::check, once all of them are known.
void read_camera(Section section, const camera::LiveConfig& live,
                 std::vector<pipeline::DeviceCamera>& cameras) {
  pipeline::DeviceCamera camera;
  camera.source.kind = "v4l2";
  camera.source.live = live;
  section.read(kCameraSettings, camera);
  read_kind(section, camera.source);
  read_settings(section, camera.source, "paced");  // a file takes the place of a live camera here
  section.finish();
  if (!section.given()) {
    return;
  }
  if (!camera::names_source(camera.source)) {
    const camera::CameraKind& kind = camera::camera_kind(camera.source.kind);
    section.fail(section.node(), kind.needs, fmt::format("is missing: {}", kind.advice));
  }
  cameras.push_back(std::move(camera));
}

void read_trigger_line(Section section, pipeline::DevicesConfig& devices) {
  constexpr std::array kRoles = {"camera", "projector"};
  constexpr std::array kDrives = {"push-pull", "open-drain", "open-source"};
  TriggerLine line;
  trigger::GpioOutput output;
  trigger::GpioReadBack read_back;
  section.read(kTriggerLineSettings, line);
  section.read(kOutputSettings, output);
  section.read(kReadBackSettings, read_back);
  if (const auto role = section.read_choice("role", kRoles)) {
    line.role = static_cast<LineRole>(*role);
  }
  if (const auto drive = section.read_choice("drive", kDrives)) {
    output.drive = static_cast<trigger::LineDrive>(*drive);
  }
  section.finish();
  if (!section.given()) {
    return;
  }
  output.name = read_back.name = line.name;
  if (devices.trigger == pipeline::TriggerKind::Gpio && (output.chip.empty() || output.line.empty())) {
    section.fail(section.node(), "chip", "a line of a GPIO trigger needs chip and line");
  }
  devices.program.lines.push_back(line);
  devices.gpio.outputs.push_back(output);
  if (!read_back.line.empty()) {
    read_back.chip = read_back.chip.empty() ? output.chip : read_back.chip;
    devices.gpio.read_backs.push_back(read_back);
  }
}

/// Lists of the projector lines that are active in one slot after the other.
void read_patterns(Section& section, TriggerProgram& program) {
  const toml::node* node = section.find("patterns");
  program.patterns = {0};
  if (node == nullptr) {
    return;
  }
  const toml::array* slots = node->as_array();
  if (slots == nullptr || slots->empty() || slots->size() > 65536) {
    section.fail(node, "patterns", "must be a list of 1 to 65536 lists of projector lines");
  }
  program.patterns.clear();
  for (const toml::node& slot : *slots) {
    LineMask active = 0;
    for (const std::string& name : section.texts(slot, "patterns")) {
      const auto at = std::find_if(program.lines.begin(), program.lines.end(),
                                   [&](const TriggerLine& line) { return line.name == name; });
      if (at == program.lines.end()) {
        section.fail(&slot, "patterns", fmt::format("there is no trigger line '{}'", name));
      }
      active |= LineMask{1} << (at - program.lines.begin());
    }
    program.patterns.push_back(active);
  }
}

/// What the slots of the patterns light the face with, in words.
void read_lights(Section& section, pipeline::DevicesConfig& devices) {
  const toml::node* node = section.find("light");
  if (node == nullptr) {
    return;
  }
  devices.lights.clear();
  for (const std::string& word : section.texts(*node, "light")) {
    try {
      devices.lights.push_back(capture::parse_slot_light(word));
    } catch (const Error& error) {
      section.fail(node, "light", error.what());
    }
  }
  if (devices.lights.size() != devices.program.patterns.size()) {
    section.fail(node, "light",
                 fmt::format("must have a word for each of the {} slots of trigger.patterns, such as "
                             "\"stripes\", \"blank\", \"light:led.top\"; it has {}",
                             devices.program.patterns.size(), devices.lights.size()));
  }
}

void read_trigger(Section section, Section& expert, pipeline::DevicesConfig& devices) {
  constexpr std::array kKinds = {"none", "virtual", "gpio"};
  if (const auto kind = section.read_choice("kind", kKinds)) {
    devices.trigger = static_cast<pipeline::TriggerKind>(*kind);
  }
  TriggerProgram& program = devices.program;
  program.exposure_ns = 5'000'000;
  section.read(kTriggerSettings, devices);
  read_expert(section, expert.section("trigger"), "trigger", expert::kTrigger, devices);
  for (Section& line : section.sections("line")) {
    read_trigger_line(line, devices);
  }
  if (devices.program.lines.size() > kMaxTriggerLines) {
    section.fail(section.node(), "line", fmt::format("there are more than {}", kMaxTriggerLines));
  }
  read_patterns(section, program);
  read_lights(section, devices);
  section.finish();
}

void read_rig(Section& root, Section& expert, const camera::LiveConfig& live, Config& config) {
  for (Section& camera : root.sections("camera")) {
    read_camera(camera, live, config.devices.cameras);
  }
  read_trigger(root.section("trigger"), expert, config.devices);
  Section simulation = root.section("simulation");
  simulation.read(kSimulationSettings, config.devices);
  simulation.finish();
  Section sets = root.section("sets");
  read_expert(sets, expert.section("sets"), "sets", expert::kSets, config.devices);
  sets.finish();
}

void read_booth(Section section, Config& config) {
  section.read(kBoothSettings, config);
  section.read_moved(renamed::kBooth, config, "[rig] file");
  if (const toml::node* node = section.find("depth_mm")) {
    const toml::array* range = node->as_array();
    const bool automatic = node->value_exact<std::string>() == "auto";
    const auto at = [&](std::size_t i) {
      const toml::node* number = range != nullptr && range->size() == 2 ? range->get(i) : nullptr;
      return number != nullptr && number->is_number() ? number->value<double>().value_or(0) : 0;
    };
    const double nearest = at(0);
    const double farthest = at(1);
    if (!automatic && !(nearest >= 50 && nearest < farthest && farthest <= 100'000)) {
      section.fail(node, "depth_mm",
                   "must be \"auto\" or two distances from the cameras, [nearest, farthest], 50 to 100000");
    }
    config.booth_depths = {static_cast<float>(nearest), static_cast<float>(farthest)};
  }
  constexpr std::array kRecords = {"pictures", "meshes"};
  if (const auto record = section.read_choice("record", kRecords)) {
    config.booth_record = static_cast<BoothRecord>(*record);
  }
  section.finish();
}

void read_refiner(Section section, Section expert, refine::RefinerConfig& refiner) {
  constexpr std::array kDetails = {"faithful", "expressive"};
  if (const auto detail = section.read_choice("detail", kDetails)) {
    refine::choose_detail(static_cast<refine::Detail>(*detail),
                          refiner);  // [expert.refiner] goes over it below
  }
  if (const toml::node* node = section.find("budget")) {
    const std::optional<std::int64_t> steps = node->value_exact<std::int64_t>();
    const std::optional<std::string> word = node->value_exact<std::string>();
    if (steps && *steps >= 1 && *steps <= 100) {
      refiner.budget = refine::Budget::Fixed;
      refiner.gauss_newton_steps = static_cast<int>(*steps);
    } else if (word == "auto" || word == "paper") {
      refiner.budget = word == "auto" ? refine::Budget::Auto : refine::Budget::Paper;
    } else {
      section.fail(node, "budget",
                   "must be \"auto\", \"paper\" or a whole number of Gauss-Newton steps from 1 to 100");
    }
  }
  Section weights = section.section("weights");
  read_expert(weights, expert.section("weights"), "refiner.weights", expert::kWeights, refiner.weights);
  weights.finish();
  read_expert(section, expert, "refiner", expert::kRefiner, refiner);
  section.finish();
}

/// A person's name as it stands; a file's, from the configuration's folder where it is relative.
void read_model(Section section, pipeline::ShadingConfig& shading) {
  section.read(kModelSettings, shading);
  section.read_moved(renamed::kModel, shading, "landmark_nets");
  if (const toml::node* node = section.find("person")) {
    shading.person = section.text(*node, "person", "a name or a file in quotes");
    if (person::is_person_path(shading.person)) {
      std::filesystem::path file;
      section.read("person", file);
      shading.person = file.string();
    } else {
      try {
        person::check_person_name(shading.person);
      } catch (const Error& error) {
        section.fail(node, "person", error.what());
      }
    }
  }
  section.finish();
}

/// Lamps that fire in turn while somebody is enrolled from the live camera.
void read_lamps(Section section, const Config& config, pipeline::LampsConfig& lamps) {
  constexpr std::size_t kMostLamps = 8;
  std::string chip;
  std::vector<std::string> lines;
  section.read("chip", chip);
  section.read("lines", lines);
  section.read(kLampsSettings, lamps);
  section.finish();
  if (lines.empty()) {
    return;
  }
  const toml::node* node = section.node();
  if (chip.empty()) {
    section.fail(node, "chip", "is missing: the GPIO chip of the lamps' lines");
  }
  if (lines.size() < 2 || lines.size() > kMostLamps ||
      std::set<std::string>(lines.begin(), lines.end()).size() != lines.size()) {
    section.fail(node, "lines", fmt::format("must be 2 to {} different lines, each of one lamp", kMostLamps));
  }
  if (config.mode != Mode::Monocular || !config.devices.cameras.empty()) {
    section.fail(
        node, "lines",
        "are for one camera in mode \"monocular\"; a booth's lamps are lines of its trigger (trigger.light)");
  }
  if (!config.pipeline.learn_live || !config.pipeline.person.empty()) {
    section.fail(node, "lines", "light whoever is learned: [model] must have learn = true and no person");
  }
  for (const std::string& line : lines) {
    lamps.outputs.push_back({fmt::format("lamp.{}", lamps.outputs.size() + 1), chip, line});
  }
}

/// "" is no folder: nobody is kept.
void read_persons(Section section, std::filesystem::path& folder) {
  if (const toml::node* node = section.find("folder")) {
    if (section.text(*node, "folder", "a path in quotes, or \"\" for none").empty()) {
      folder.clear();
    } else {
      section.read("folder", folder);
    }
  }
  section.finish();
}

void check_socket(Section& section, const std::filesystem::path& socket) {
  const std::size_t bytes = socket.native().size();
  if (bytes > stream::kMaxSocketPathBytes) {
    section.fail(
        section.find("socket"), "socket",
        fmt::format("'{}' has {} bytes, {} is the most that a socket's path can have: choose a shorter "
                    "folder",
                    socket.string(), bytes, stream::kMaxSocketPathBytes));
  }
}

void read_stream(Section section, Section& expert, stream::StreamServerConfig& stream) {
  section.read(kStreamSettings, stream);
  check_socket(section, stream.socket);
  section.read_mode("mode", stream.access.mode);
  read_expert(section, expert.section("stream"), "stream", expert::kStream, stream);
  section.finish();
}

void read_control(Section section, const std::filesystem::path& stream_socket, ControlConfig& control) {
  section.read(kControlSettings, control);
  check_socket(section, control.socket);
  if (control.socket.lexically_normal() == stream_socket.lexically_normal()) {
    section.fail(section.find("socket"), "socket",
                 fmt::format("'{}' is stream.socket, too: choose another path for one of them",
                             control.socket.string()));
  }
  section.read_mode("mode", control.access.mode);
  section.finish();
}

void read_takes(Section section, Section& expert, TakesConfig& takes) {
  section.read(kTakesSettings, takes);
  read_expert(section, expert.section("takes"), "takes", expert::kTakes, takes);
  section.finish();
}

/// "ADDRESS:PORT", or "" for none.
void read_listen(Section& section, std::string& listen, int sample_port) {
  if (const toml::node* node = section.find("listen")) {
    listen = section.text(*node, "listen", files::kAnyText);
    const std::size_t colon = listen.rfind(':');
    const std::string port = colon == std::string::npos ? "" : listen.substr(colon + 1);
    const bool digits = !port.empty() && port.size() <= 5 &&
                        std::all_of(port.begin(), port.end(), [](char c) { return c >= '0' && c <= '9'; });
    if (!listen.empty() && (colon == 0 || !digits || std::stoi(port) > 65535)) {
      section.fail(
          node, "listen",
          fmt::format("must be \"ADDRESS:PORT\" such as \"127.0.0.1:{}\", or \"\" for none", sample_port));
    }
  }
}

void read_metrics(Section section, MetricsConfig& metrics) {
  read_listen(section, metrics.listen, 9464);
  section.finish();
}

/// Whether two "ADDRESS:PORT" that read_listen took can't be listened on together.
bool same_listener(const std::string& one, const std::string& other) {
  const auto apart = [](const std::string& listen) {
    HostAndPort found = split_host(listen);
    found.host = found.host == "localhost" ? "127.0.0.1" : found.host;
    return found;
  };
  const auto every_address = [](const std::string& host) { return host == "0.0.0.0" || host == "::"; };
  const HostAndPort a = apart(one);
  const HostAndPort b = apart(other);
  constexpr int kAnyFreePort = 0;
  return !one.empty() && !other.empty() && std::stoi(a.port) == std::stoi(b.port) &&
         std::stoi(a.port) != kAnyFreePort &&
         (a.host == b.host || every_address(a.host) || every_address(b.host));
}

/// Whether an address of "ADDRESS:PORT" is this machine's own alone.
bool is_loopback(const std::string& host) {
  in_addr four{};
  in6_addr six{};
  constexpr std::uint32_t kLoopbackNet = 127;
  return host == "localhost" ||
         (::inet_pton(AF_INET, host.c_str(), &four) == 1 && ntohl(four.s_addr) >> 24U == kLoopbackNet) ||
         (::inet_pton(AF_INET6, host.c_str(), &six) == 1 && IN6_IS_ADDR_LOOPBACK(&six));
}

void read_web(Section section, Section& expert, const MetricsConfig& metrics, WebConfig& web) {
  read_listen(section, web.listen, 8420);
  if (same_listener(web.listen, metrics.listen)) {
    section.fail(
        section.find("listen"), "listen",
        fmt::format("\"{}\" and metrics.listen (\"{}\") are the same port: choose another for one of "
                    "them",
                    web.listen, metrics.listen));
  }
  section.read(kWebSettings, web);
  if (!web.listen.empty() && !is_loopback(split_host(web.listen).host) && !web.is_public) {
    section.fail(section.find("listen"), "listen",
                 fmt::format("\"{}\" lets everybody who reaches this machine look at faces and load takes, "
                             "without encryption: listen on 127.0.0.1 behind a proxy with TLS "
                             "(docs/web.md), or add public = true if that is meant",
                             web.listen));
  }
  if (const toml::node* node = section.find("token_file")) {
    if (section.text(*node, "token_file", files::kAnyText).empty()) {
      web.token_file.clear();
    } else {
      section.read("token_file", web.token_file);
    }
  }
  if (!web.listen.empty() && web.is_public && !web.open_look && web.token_file.empty()) {
    section.fail(
        section.find("public"), "public",
        "looking needs a token there, and token_file = \"\" makes none: name a file, or let everybody "
        "look with open_look = true");
  }
  read_expert(section, expert.section("web"), "web", expert::kWeb, web);
  section.read_moved(renamed::kWeb, web, "[expert.web] max_readers");
  section.finish();
}

void read_bridges(Section section, avatar::BridgeConfig& bridges) {
  for (const avatar::BridgeProtocolNames& names : avatar::kBridgeProtocols) {
    const std::string key = names.key;
    std::vector<std::string> texts;
    section.read(key, texts);
    for (const std::string& text : texts) {
      const auto target = avatar::parse_target(names.protocol, text);
      if (!target) {
        section.fail(
            section.find(key), key,
            fmt::format("must be a list of \"ADDRESS:PORT\", each an IP address in digits or the name "
                        "of a host, such as [\"127.0.0.1:{}\"]; \"{}\" is none",
                        names.usual_port, text));
      }
      bridges.targets.push_back(*target);
    }
  }
  section.read(kBridgesSettings, bridges);
  if (const auto shapes = section.read_choice("vmc_shapes", avatar::kVmcShapes)) {
    bridges.vmc_shapes = static_cast<avatar::VmcShapes>(*shapes);
  }
  if (const auto find = section.read_choice("vrchat_find", avatar::kVrChatFinds)) {
    bridges.find.where = static_cast<avatar::VrChatFind>(*find);
  }
  if (!bridges.answer.empty() && avatar::socket_address(bridges.answer, 0).length == 0) {
    section.fail(section.find("answer"), "answer",
                 "must be an IP address of this machine in digits, such as \"0.0.0.0\", or \"\" for none");
  }
  bridges.values = avatar::read_tunings(section.section("values"));
  if (bridges.subject.empty() || bridges.subject.size() > 64) {
    section.fail(section.find("subject"), "subject", "must be a name of 1 to 64 bytes");
  }
  section.finish();
}

void read_sound(Section section, sound::SoundConfig& sound) {
  section.read(kSoundSettings, sound);
  if (sound.timecode_channel > sound.channels) {
    section.fail(section.find("timecode_channel"), "timecode_channel",
                 fmt::format("is {}, but only {} channel{} taken (channels)", sound.timecode_channel,
                             sound.channels, sound.channels == 1 ? " is" : "s are"));
  }
  section.finish();
}

void read_osc(Section section, OscConfig& osc) {
  read_listen(section, osc.listen, 8000);
  section.read(kOscSettings, osc);
  if (!osc.listen.empty() && !is_loopback(split_host(osc.listen).host) && !osc.is_public) {
    section.fail(section.find("listen"), "listen",
                 fmt::format("\"{}\" lets everybody who reaches this machine begin and end takes: listen on "
                             "127.0.0.1, or add public = true if that is meant",
                             osc.listen));
  }
  section.finish();
}

void read_all(Document& document, Config& config) {
  Section root(document, &document.root(), "");
  if (const auto mode = root.read_choice("mode", kModes)) {
    config.mode = static_cast<Mode>(*mode);
  }
  Section expert = root.section("expert");
  Section cameras = expert.section("camera");
  cameras.read(expert::kCamera, config.pipeline.source);
  cameras.finish();
  const camera::LiveConfig live = config.pipeline.source.live;
  read_source(root.section("source"), config);
  read_rig(root, expert, live, config);
  Section rig = root.section("rig");
  rig.read(kRigSettings, config);
  rig.finish();
  read_booth(root.section("booth"), config);
  read_model(root.section("model"), config.pipeline);
  read_persons(root.section("persons"), config.pipeline.persons_folder);
  read_lamps(root.section("lamps"), config, config.pipeline.lamps);
  Section tracker = root.section("tracker");
  read_expert(tracker, expert.section("tracker"), "tracker", expert::kTracker, config.pipeline.tracker);
  tracker.finish();
  Section hierarchy = root.section("hierarchy");
  read_expert(hierarchy, expert.section("hierarchy"), "hierarchy", expert::kHierarchy,
              config.pipeline.hierarchy);
  hierarchy.finish();
  read_refiner(root.section("refiner"), expert.section("refiner"), config.pipeline.refiner);
  Section gpu = root.section("gpu");
  gpu.read(kGpuSettings, config.pipeline);
  gpu.finish();
  read_stream(root.section("stream"), expert, config.stream);
  read_control(root.section("control"), config.stream.socket, config.control);
  read_takes(root.section("takes"), expert, config.takes);
  read_sound(root.section("sound"), config.sound);
  read_osc(root.section("osc"), config.osc);
  read_bridges(root.section("bridges"), config.bridges);
  read_metrics(root.section("metrics"), config.metrics);
  read_web(root.section("web"), expert, config.metrics, config.web);
  config.stream.max_web_readers = config.web.listen.empty() ? 0 : config.web.max_readers;
  Section log = root.section("log");
  constexpr std::array kLevels = {"error", "warning", "info", "debug"};
  if (const auto level = log.read_choice("level", kLevels)) {
    config.log_level = static_cast<LogLevel>(*level);
  }
  log.finish();
  expert.finish();
  root.finish();
}

}  // namespace

Config default_config() {
  Config config;
  config.pipeline.model_file = default_model_file();
  config.pipeline.tracker.landmark_nets = default_landmark_nets();
  config.pipeline.learn_live = true;
  config.stream.socket = "/run/facet/stream.sock";
  const std::filesystem::path page = share_beside_program() / "kiosk";
  std::error_code ignored;
  config.web.page =
      std::filesystem::is_directory(page, ignored) ? page : std::filesystem::path(FACET_KIOSK_FOLDER);
  return config;
}

Config parse_config(std::string_view text, const std::filesystem::path& file) {
  Config config = default_config();
  files::read_toml(text, file, [&](Document& document) {
    read_all(document, config);
    config.warnings = std::move(document.warnings);
  });
  return config;
}

Config load_config(const std::filesystem::path& file) {
  return parse_config(files::read_text(file, kMaxConfigBytes, "configuration file"), file);
}

pipeline::BoothConfig booth_config(const Config& config) {
  pipeline::BoothConfig booth;
  booth.rig_file = config.rig_file;
  booth.depths = config.booth_depths;
  booth.every_slot = config.booth_every_slot;
  booth.lights = config.booth_lights;
  booth.shading = config.booth_shading;
  booth.model_file = config.pipeline.model_file;
  booth.landmark_nets = config.pipeline.tracker.landmark_nets;
  booth.gpu_device = config.pipeline.gpu_device;
  if (config.devices.trigger != pipeline::TriggerKind::None) {
    booth.program = pipeline::lights_of(config.devices);
  }
  return booth;
}

bool has_live_cameras(const Config& config) {
  return config.mode == Mode::Monocular && !config.devices.cameras.empty();
}

std::vector<files::TomlKey> config_values(std::string_view text, const std::filesystem::path& file) {
  Config config = default_config();
  std::vector<files::TomlKey> values;
  files::read_toml(text, file, [&](Document& document) {
    read_all(document, config);
    values = std::move(document.keys);
  });
  return values;
}

}  // namespace facet::service
