// `facet booth-demo`: the whole way of a booth without hardware, as the commands that a user would give.

#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "capture/rig_file.hpp"
#include "facet/assets.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "options.hpp"
#include "programs.hpp"
#include "progress.hpp"
#include "service/control_client.hpp"
#include "stop_signals.hpp"
#include "take/reader.hpp"
#include "tell.hpp"

extern char** environ;

namespace facet::tools {
namespace {

using namespace std::chrono_literals;

constexpr auto kPollPeriod = 50ms;
constexpr auto kOpeningPatience = 60s;
constexpr auto kRecordingPatience = 60s;
constexpr auto kEndingPatience = 20s;
/// A third of the speed that the performance was rendered at: pictures of six cameras that nobody has to
/// hurry with, on machines that are busy, too.
constexpr double kSlotsPerSecond = 20;
/// Fringes, and lamps above and below the cameras in turn, to see folds by. Each slot has lines of its own,
/// by which the simulated cameras know it.
struct DemoSlot {
  const char* light;
  std::vector<const char*> lines;
};
const std::vector<DemoSlot>& demo_program() {
  static const std::vector<DemoSlot> program{
      {"fringes:0", {"fringes.a"}},
      {"fringes:1", {"fringes.b"}},
      {"blank", {}},
      {"fringes:2", {"fringes.a", "half"}},
      {"fringes:3", {"fringes.b", "half"}},
      {"light:top", {"top"}},
      {"light:low", {"low"}},
  };
  return program;
}

struct DemoOptions {
  std::uint64_t seed = 5;
  std::uint64_t slots = 35;
  int samples = 2;
  double resolution = 1;
  std::string model = default_model_file().string();
  std::string landmark_nets = default_landmark_nets().string();
  std::string device = "auto";
  std::string folder;
};

/// A child that is ended with this object.
class Child {
 public:
  /// log: file for its standard error; empty: ours.
  Child(const std::string& name, std::vector<std::string> arguments, const std::filesystem::path& log = {}) {
    const std::string path = program(name).string();
    arguments.insert(arguments.begin(), name);
    std::vector<char*> argv;
    argv.reserve(arguments.size() + 1);
    for (std::string& argument : arguments) {
      argv.push_back(argument.data());
    }
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    if (!log.empty()) {
      ::posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, log.c_str(),
                                         O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    }
    // It takes its signals as it was made to; we hold ours back.
    posix_spawnattr_t attributes;
    ::posix_spawnattr_init(&attributes);
    sigset_t none;
    sigemptyset(&none);
    ::posix_spawnattr_setsigmask(&attributes, &none);
    ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK);
    const int error = ::posix_spawn(&pid_, path.c_str(), &actions, &attributes, argv.data(), environ);
    ::posix_spawnattr_destroy(&attributes);
    ::posix_spawn_file_actions_destroy(&actions);
    if (error != 0) {
      pid_ = -1;
      throw Error(ErrorKind::Internal, fmt::format("cannot start {}: {}", path, std::strerror(error)));
    }
  }
  ~Child() {
    if (pid_ > 0) {
      ::kill(pid_, SIGTERM);
      wait(kEndingPatience);
      if (pid_ > 0) {
        ::kill(pid_, SIGKILL);
        wait(kEndingPatience);
      }
    }
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  /// Whether it has ended by now.
  bool ended() {
    int status = 0;
    if (pid_ > 0 && ::waitpid(pid_, &status, WNOHANG) == pid_) {
      pid_ = -1;
      exit_status_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    }
    return pid_ < 0;
  }
  bool wait(Clock::duration patience) {
    const Clock::time_point end = Clock::now() + patience;
    while (!ended() && Clock::now() < end) {
      std::this_thread::sleep_for(kPollPeriod);
    }
    return pid_ < 0;
  }
  int exit_status() const { return exit_status_; }

 private:
  pid_t pid_ = -1;
  int exit_status_ = 0;
};

class Demo {
 public:
  explicit Demo(DemoOptions options) : options_(std::move(options)), folder_(options_.folder) {}

  void run() {
    try {
      run_all();
    } catch (const Stopped& stopped) {
      signals_.die_of(stopped.signal);
    }
  }

 private:
  void run_all() {
    render();
    record();
    check_recording();
    step({"process", "--rig", in("booth/rig.toml"), in("pictures.take"), "-o", in("meshes.take"), "--depth",
          in("depth"), "--config", in("booth.toml")});
    step({"summary", in("meshes.take")});
    view("meshes.take", "booth-sheet.png");
    // What the lamps bring: the same without what they say, from the same depth maps.
    step({"process", "--rig", in("booth/rig.toml"), in("pictures.take"), "-o", in("by-depth.take"), "--depth",
          in("depth"), "--config", in("booth.toml"), "--no-lights"});
    view("by-depth.take", "by-depth-sheet.png");
    tell("\nLook at {}, and at {} for the same without lamps\n", in("booth-sheet.png"),
         in("by-depth-sheet.png"));
  }

  void view(const std::string& take, const std::string& sheet) const {
    step({"view", in(take), "--rig", in("booth/rig.toml"), "--pictures", in("pictures.take"), "--depth",
          in("depth"), "--truth", in("booth"), "-o", in(sheet)});
  }

  std::string in(const std::string& name) const { return (folder_ / name).string(); }

  /// Thrown where a signal asks for the end, so that children and folders are cleaned up on the way out.
  struct Stopped {
    int signal;
  };

  void stop_if_asked() const {
    if (const int signal = signals_.pending(); signal != 0) {
      throw Stopped{signal};
    }
  }

  /// Shows a command and runs it to its end.
  void step(const std::vector<std::string>& arguments) const {
    tell("\n==> facet {}\n", fmt::format("{}", fmt::join(arguments, " ")));
    std::fflush(stdout);
    Child child("facet", arguments);
    while (!child.wait(kPollPeriod)) {
      stop_if_asked();
    }
    stop_if_asked();  // the child may have met the signal first
    if (child.exit_status() != 0) {
      throw Error(static_cast<ErrorKind>(child.exit_status()),
                  fmt::format("`facet {}` ended with status {}", arguments.front(), child.exit_status()));
    }
  }

  void render() const {
    files::make_folder(folder_);
    std::vector<std::string> words;
    for (const DemoSlot& slot : demo_program()) {
      words.emplace_back(slot.light);
    }
    step({"synth-booth",
          "--seed",
          std::to_string(options_.seed),
          "--slots",
          std::to_string(options_.slots),
          "--samples",
          std::to_string(options_.samples),
          "--resolution",
          fmt::format("{}", options_.resolution),
          "--model",
          options_.model,
          "--program",
          fmt::format("{}", fmt::join(words, ",")),
          "--lamp",
          "top=0,550,850",
          "--lamp",
          "low=0,-550,850",
          "--gloss",
          "0.04",
          "-o",
          in("booth")});
  }

  void write_config(const std::filesystem::path& sockets) const {
    const capture::Rig rig = capture::read_rig(folder_ / "booth/rig.toml");
    std::string text =
        "# The virtual booth as facetd's devices: `facet booth-demo` wrote this.\nmode = \"booth\"\n";
    for (const capture::RigCamera& camera : rig.cameras) {
      text += fmt::format(
          "[[camera]]\nname = \"{}\"\nkind = \"simulated\"\nwidth_px = {}\nheight_px = {}\n"
          "rate_hz = {:.1f}\n",
          camera.name, camera.lens.width_px, camera.lens.height_px, kSlotsPerSecond);
    }
    text += fmt::format("[trigger]\nkind = \"virtual\"\nslots_per_second = {:.1f}\nexposure_us = 5000\n",
                        kSlotsPerSecond);
    std::vector<std::string> patterns;
    std::vector<std::string> lights;
    for (const DemoSlot& slot : demo_program()) {
      std::vector<std::string> lines;
      for (const char* line : slot.lines) {
        lines.push_back(fmt::format("\"{}\"", line));
      }
      patterns.push_back(fmt::format("[{}]", fmt::join(lines, ", ")));
      lights.push_back(fmt::format("\"{}\"", slot.light));
    }
    text += fmt::format("patterns = [{}]\nlight = [{}]\nedge_log = \"edges.log\"\n",
                        fmt::join(patterns, ", "), fmt::join(lights, ", "));
    for (const char* line : {"cameras", "fringes.a", "fringes.b", "half", "top", "low"}) {
      text += fmt::format("[[trigger.line]]\nname = \"{}\"\nrole = \"{}\"\n", line,
                          std::strcmp(line, "cameras") == 0 ? "camera" : "projector");
    }
    text += fmt::format(
        "[simulation]\nfootage = \"booth/capture.take\"\n[rig]\nfile = \"booth/rig.toml\"\n"
        "[model]\npath = '{}'\nlandmark_nets = '{}'\n[gpu]\ndevice = '{}'\n[stream]\nsocket = '{}'\n"
        "[control]\nsocket = '{}'\n[takes]\nfolder = \".\"\nrecord_at_start = "
        "\"pictures\"\n[metrics]\nlisten = "
        "\"\"\n",
        std::filesystem::absolute(options_.model).string(),
        std::filesystem::absolute(options_.landmark_nets).string(), options_.device,
        (sockets / "stream.sock").string(), (sockets / "control.sock").string());
    files::OutputFile file(folder_ / "booth.toml");
    file.write(text);
    file.commit();
  }

  /// The daemon's answer; throws where it has ended.
  nlohmann::json ask(Child& daemon, const std::filesystem::path& socket, const char* method) const {
    for (const Clock::time_point end = Clock::now() + kOpeningPatience;;) {
      stop_if_asked();
      if (daemon.ended()) {
        throw Error(
            daemon.exit_status() > 0 ? static_cast<ErrorKind>(daemon.exit_status()) : ErrorKind::Internal,
            fmt::format("facetd ended with status {}: see {}", daemon.exit_status(), in("facetd.log")));
      }
      try {
        return service::ControlClient(socket).call(method, nlohmann::json::object());
      } catch (const Error& error) {
        if (error.kind() != ErrorKind::Unavailable || Clock::now() >= end) {
          throw;
        }
      }
      std::this_thread::sleep_for(kPollPeriod);
    }
  }

  /// Runs facetd on the virtual booth until it has recorded the performance.
  void record() const {
    std::string name = (std::filesystem::temp_directory_path() / "facet-demo-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) {
      throw Error(ErrorKind::Storage,
                  fmt::format("cannot make a folder for sockets: {}", std::strerror(errno)));
    }
    const std::filesystem::path sockets = name;
    try {
      write_config(sockets);
      tell("\n==> facetd --config {}\n", in("booth.toml"));
      std::fflush(stdout);
      record(sockets / "control.sock");
    } catch (...) {
      std::error_code ignored;
      std::filesystem::remove_all(sockets, ignored);
      throw;
    }
    std::filesystem::remove_all(sockets);
  }

  void record(const std::filesystem::path& socket) const {
    Child daemon("facetd", {"--config", in("booth.toml")}, folder_ / "facetd.log");
    Progress progress("Recording", options_.slots, "slots");
    const Clock::time_point end = Clock::now() + kOpeningPatience + kRecordingPatience;
    std::uint64_t recorded = 0;
    while (recorded < options_.slots) {
      const nlohmann::json status = ask(daemon, socket, "status");
      // The first sets come while cameras are still being opened.
      recorded =
          status.at("rig").is_object() ? status.at("rig").at("sets").at("complete").get<std::uint64_t>() : 0;
      progress.set(std::min(recorded, options_.slots), status.at("state").get<std::string>());
      if (Clock::now() > end) {
        throw Error(ErrorKind::Unavailable,
                    fmt::format("facetd recorded {} of {} slots in {} s: see {}", recorded, options_.slots,
                                std::chrono::seconds(kOpeningPatience + kRecordingPatience).count(),
                                in("facetd.log")));
      }
      std::this_thread::sleep_for(kPollPeriod);
    }
    progress.finish();
    ask(daemon, socket, "record.stop");
    ask(daemon, socket, "shutdown");
    daemon.wait(kEndingPatience);
  }

  /// What every recorded picture must be: its camera's, of one slot of the footage, under the light that the
  /// lines of its own slot selected.
  void check_recording() const {
    take::TakeReader footage(folder_ / "booth/capture.take");
    take::TakeReader recorded(folder_ / "pictures.take");
    std::vector<std::shared_ptr<const mesh::MeshFrame>> shown;
    for (std::int64_t i = 0; i < footage.frame_count(); ++i) {
      shown.push_back(footage.frame(i));
    }
    std::int64_t right = 0;
    std::int64_t incomplete = 0;
    for (std::int64_t i = 0; i < recorded.frame_count(); ++i) {
      const auto frame = recorded.frame(i);
      const bool found = std::any_of(shown.begin(), shown.end(), [&](const auto& slot) {
        return slot->images->light == frame->images->light && same_pictures(*slot->images, *frame->images);
      });
      right += found ? 1 : 0;
      incomplete += frame->images->complete() ? 0 : 1;
    }
    tell("{} of {} recorded sets show in every camera what the trigger's lines selected; {} are incomplete\n",
         right, recorded.frame_count(), incomplete);
    if (2 * incomplete > recorded.frame_count()) {
      tell("this machine was too busy for {} sets a second: fewer meshes, and less of each, come of it\n",
           kSlotsPerSecond);
    }
    if (right == 0 || right + incomplete < recorded.frame_count()) {
      throw Error(ErrorKind::Internal,
                  fmt::format("{} recorded sets do not show what the booth was rendered to show",
                              recorded.frame_count() - right - incomplete));
    }
  }

  static bool same_pictures(const FrameSet& a, const FrameSet& b) {
    return std::equal(
        a.frames.begin(), a.frames.end(), b.frames.begin(), b.frames.end(),
        [](const Frame& one, const Frame& other) {
          if (one.empty() || other.empty() || one.width_px != other.width_px ||
              one.height_px != other.height_px) {
            return false;
          }
          for (int y = 0; y < one.height_px; ++y) {
            if (std::memcmp(one.row(y), other.row(y), 4 * static_cast<std::size_t>(one.width_px)) != 0) {
              return false;
            }
          }
          return true;
        });
  }

  DemoOptions options_;
  std::filesystem::path folder_;
  StopSignals signals_;
};

}  // namespace

void add_booth_demo_command(Command app) {
  auto options = std::make_shared<DemoOptions>();
  const Command command = app.subcommand("booth-demo",
                                         "The whole way of a booth without hardware: render a virtual one, "
                                         "run facetd on it, record, make meshes, draw "
                                         "a sheet");
  command.option("--seed", options->seed, "Of the virtual booth").shows_default();
  command.option("--slots", options->slots, "Length of the performance; a seventh of it become meshes")
      .shows_default()
      .range(14, 3600);
  command
      .option("--resolution", options->resolution,
              "Of the cameras: 1 is 640x480 px, 0.5 is 320x240, a quarter of the work")
      .shows_default()
      .range(0.25, 4.0);
  command.option("--samples", options->samples, "Rays a pixel").shows_default().range(1, 64);
  command.option("--model", options->model, "Face model").shows_default();
  command.option("--landmark-nets,--landmark-assets", options->landmark_nets, "MediaPipe's landmark nets")
      .shows_default();
  command.option("--device", options->device, "Vulkan device: auto or part of its name").shows_default();
  command.option("-o,--output", options->folder, "Folder to write into; must not hold an earlier demo")
      .required();
  command.callback([options] { Demo(*options).run(); });
}

}  // namespace facet::tools
