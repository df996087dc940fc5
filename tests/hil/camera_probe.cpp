// Opens a camera through the product's own driver and tells what it does, as JSON, one object a line:
//   {"event":"open", ...}     what the camera says of itself, or {"event":"refused","error":...} and exit 1
//   {"event":"state", ...}    every change of its state or reason
//   {"event":"frame", ...}    every frame (unless --quiet): number, time, what is painted into it
//   {"event":"status", ...}   counters, descriptors and memory: for each line on standard input, and at the
//   end
// Ends after --seconds, at the end of standard input, or with SIGTERM. Times are CLOCK_MONOTONIC in ns.

#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "camera/factory.hpp"
#include "facet/camera.hpp"
#include "facet/error.hpp"
#include "painted_number.hpp"

namespace facet::hil {
namespace {

using nlohmann::json;

volatile std::sig_atomic_t stop_requested = 0;

std::int64_t now_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000LL + now.tv_nsec;
}

void say(const json& line) {
  fmt::print("{}\n", line.dump());
  std::fflush(stdout);
}

/// Memory that this process has in use, in kB.
long resident_kb() {
  long pages = 0;
  long resident = 0;
  std::ifstream("/proc/self/statm") >> pages >> resident;
  return resident * (::sysconf(_SC_PAGESIZE) / 1024);
}

long descriptors() {
  const std::filesystem::directory_iterator open("/proc/self/fd");
  return static_cast<long>(std::distance(begin(open), end(open))) - 1;  // the folder itself
}

json status_line(const Camera& camera) {
  const CameraStatus status = camera.status();
  json line = {{"event", "status"},       {"time_ns", now_ns()},          {"state", to_string(status.state)},
               {"reason", status.reason}, {"descriptors", descriptors()}, {"resident_kb", resident_kb()}};
  for (const CameraCount& count : kCameraCounts) {
    line[count.name] = status.counters.*count.value;
  }
  return line;
}

json frame_line(const Frame& frame) {
  json line = {{"event", "frame"},
               {"arrival_ns", now_ns()},
               {"sequence", frame.sequence},
               {"timestamp_ns", frame.timestamp_ns},
               {"corrupt", frame.corrupt}};
  if (const auto number = read_number(frame)) {
    line["picture"] = number->picture;
    line["pattern"] = number->pattern;
  }
  return line;
}

/// What stands on standard input: nothing, a line, or its end.
enum class Input { Nothing, Line, End };
Input read_input() {
  pollfd input{STDIN_FILENO, POLLIN, 0};
  if (::poll(&input, 1, 0) <= 0) {
    return Input::Nothing;
  }
  char letter = 0;
  while (::read(STDIN_FILENO, &letter, 1) == 1) {
    if (letter == '\n') {
      return Input::Line;
    }
  }
  return Input::End;
}

void watch(Camera& camera, double seconds, bool quiet) {
  camera.start();
  const std::int64_t end_ns = now_ns() + static_cast<std::int64_t>(seconds * 1e9);
  std::optional<CameraStatus> shown;
  Frame frame;
  for (Input input = Input::Nothing; input != Input::End && stop_requested == 0 && now_ns() < end_ns;
       input = read_input()) {
    if (input == Input::Line) {
      say(status_line(camera));
    }
    const CaptureOutcome outcome = camera.next(frame, std::chrono::milliseconds(20));
    const CameraStatus status = camera.status();
    if (!shown || shown->state != status.state || shown->reason != status.reason) {
      say({{"event", "state"},
           {"time_ns", now_ns()},
           {"state", to_string(status.state)},
           {"reason", status.reason}});
      shown = status;
    }
    if (outcome == CaptureOutcome::Delivered && !quiet) {
      say(frame_line(frame));
    }
  }
  say(status_line(camera));
  camera.stop();
}

int run(int argc, char** argv) {
  camera::CameraConfig config;
  config.kind = "v4l2";
  config.live.width_px = 640;
  config.live.height_px = 480;
  int stall_ms = 2000;
  double seconds = 1e6;
  bool quiet = false;
  std::optional<double> gain;
  std::vector<std::string> controls;
  CLI::App app("Tells what a camera does, as JSON lines");
  app.add_option("device", config.live.device, "or its id in libcamera")->required();
  app.add_option("--kind", config.kind);
  app.add_option("--width", config.live.width_px);
  app.add_option("--height", config.live.height_px);
  app.add_option("--rate", config.live.rate_hz);
  app.add_option("--format", config.live.format);
  app.add_option("--buffers", config.live.buffers);
  app.add_option("--exposure-us", config.live.exposure_us);
  app.add_option("--gain", gain);
  app.add_option("--white-balance-k", config.live.white_balance_k);
  app.add_option("--stall-ms", stall_ms);
  app.add_option("--control", controls, "NAME=VALUE, the value as JSON; several");
  app.add_option("--seconds", seconds);
  app.add_flag("--quiet", quiet, "no line for a frame");
  CLI11_PARSE(app, argc, argv);
  config.live.stall_after = std::chrono::milliseconds(stall_ms);
  for (const std::string& control : controls) {
    const std::size_t at = control.find('=');
    const json value = json::parse(control.substr(at + 1));
    camera::ControlSetting& setting = config.live.controls.emplace_back();
    setting.name = control.substr(0, at);
    if (value.is_boolean()) {
      setting.value = value.get<bool>();
    } else if (value.is_string()) {
      setting.value = value.get<std::string>();
    } else {
      setting.value = value.get<std::int64_t>();
    }
  }
  if (config.kind == "libcamera") {
    config.libcamera.id = config.live.device.string();
    config.libcamera.gain = gain;
  } else if (gain) {
    config.live.gain = static_cast<int>(*gain);
  }
  try {
    const auto camera = camera::open_camera(config);
    const CameraInfo info = camera->info();
    const CameraStatus status = camera->status();
    say({{"event", "open"},
         {"name", info.name},
         {"width_px", info.width_px},
         {"height_px", info.height_px},
         {"rate_hz", info.rate_hz},
         {"state", to_string(status.state)},
         {"reason", status.reason}});
    watch(*camera, seconds, quiet);
  } catch (const Error& error) {
    say({{"event", "refused"}, {"error", error.what()}});
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace facet::hil

int main(int argc, char** argv) {
  std::signal(SIGTERM, [](int) { facet::hil::stop_requested = 1; });
  return facet::hil::run(argc, argv);
}
