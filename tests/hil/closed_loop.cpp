// Runs a trigger on GPIO lines and collects the frame sets of cameras that watch those lines (usb_camera
// --lines): every frame of a delivered set must show the pattern of the set's slot.
//
//   closed_loop --chip NAME --camera DEVICE [--camera DEVICE]... [--rate HZ] [--edges FILE]
//
// Lines by offset: 0 to 7 show the slot's number modulo 256, 8 fires the cameras, 9 is wired to 8 and proves
// its edges. The first slot is fired once all cameras are open, with --no-wait at once. Runs until the end of
// standard input or for --seconds. Prints JSON, one object a line: "wrong" for every frame in the wrong set,
// "status" for each line of input and at the end. --edges: the trigger's edge log of the first slots.

#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "camera/factory.hpp"
#include "capture/frame_set_assembler.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "painted_number.hpp"
#include "trigger/edge_log.hpp"
#include "trigger/gpio_trigger.hpp"

namespace facet::hil {
namespace {

using nlohmann::json;
using namespace std::chrono_literals;

constexpr int kPatternLines = 8;
constexpr std::uint64_t kPatterns = 1ULL << kPatternLines;
constexpr std::uint64_t kLoggedSlots = 8;

struct Options {
  std::string chip;
  std::vector<std::string> cameras;
  double rate_hz = 30;
  int width_px = 320;
  int height_px = 240;
  double seconds = 1e6;
  std::string edges;
  bool wait = true;
};

/// Slot n shows n modulo 256 on lines 0 to 7 while line 8 fires the cameras.
TriggerProgram counting_program(double slots_per_second) {
  TriggerProgram program;
  program.slots_per_second = slots_per_second;
  const auto period_ns = static_cast<std::int64_t>(1e9 / slots_per_second);
  program.settle_ns = period_ns / 8;
  program.exposure_ns = period_ns / 2;
  program.tolerance_ns = period_ns / 4;  // an emulated processor keeps no better time
  for (int i = 0; i < kPatternLines; ++i) {
    program.lines.push_back({.name = fmt::format("bit{}", i), .role = LineRole::Projector});
  }
  program.lines.push_back({.name = "cameras"});
  for (std::uint64_t slot = 0; slot < kPatterns; ++slot) {
    program.patterns.push_back(slot);
  }
  return program;
}

trigger::GpioTriggerConfig wiring(const TriggerProgram& program, const std::string& chip) {
  trigger::GpioTriggerConfig config;
  for (std::size_t i = 0; i < program.lines.size(); ++i) {
    config.outputs.push_back({program.lines[i].name, chip, std::to_string(i)});
  }
  config.read_backs = {{"cameras", chip, std::to_string(program.lines.size())}};
  config.thread.real_time = true;
  return config;
}

class ClosedLoop {
 public:
  explicit ClosedLoop(const Options& options)
      : options_(options), program_(counting_program(options.rate_hz)) {
    capture::CaptureConfig capture;
    capture.period_ns = static_cast<std::int64_t>(1e9 / options.rate_hz);
    // USB and emulation: the first payload comes milliseconds after the edge, the picture later.
    capture.deadline_ns = 500'000'000;
    capture.open_sets = 32;
    for (const std::string& device : options.cameras) {
      camera::CameraConfig config;
      config.kind = "v4l2";
      config.live.device = device;
      config.live.width_px = options.width_px;
      config.live.height_px = options.height_px;
      config.live.rate_hz = options.rate_hz;
      cameras_.push_back(camera::open_camera(config));
      capture.cameras.push_back({device, 0});
    }
    assembler_ = std::make_unique<capture::FrameSetAssembler>(capture);
    trigger_ = trigger::open_gpio_trigger(program_, wiring(program_, options.chip));
    log_.lines = program_.lines;
  }

  void run() {
    std::vector<std::thread> threads;
    for (std::size_t i = 0; i < cameras_.size(); ++i) {
      threads.emplace_back([this, i] { read_camera(i); });
    }
    // A camera that has not begun to stream misses nothing yet.
    while (options_.wait && !all_stream()) {
      std::this_thread::sleep_for(10ms);
    }
    trigger_->start(0);
    threads.emplace_back([this] { read_trigger(); });
    threads.emplace_back([this] { check_sets(); });
    watch_input();
    trigger_->request_stop();
    trigger_->stop();
    std::this_thread::sleep_for(1s);
    stop_ = true;
    assembler_->close();
    for (std::thread& thread : threads) {
      thread.join();
    }
    say_status();
    if (!options_.edges.empty()) {
      std::ofstream(options_.edges) << trigger::to_text(log_);
    }
  }

 private:
  void say(const json& line) {
    const std::scoped_lock lock(print_mutex_);
    fmt::print("{}\n", line.dump());
    std::fflush(stdout);
  }

  bool all_stream() const {
    // A triggered camera sends nothing before it is fired: open is as far as it comes.
    return std::all_of(cameras_.begin(), cameras_.end(), [](const auto& camera) {
      const CameraState state = camera->status().state;
      return state == CameraState::Opening || state == CameraState::Streaming;
    });
  }

  void read_camera(std::size_t index) {
    Camera& camera = *cameras_[index];
    camera.start();
    Frame frame;
    while (!stop_) {
      const CaptureOutcome outcome = camera.next(frame, 50ms);
      const CameraState state = camera.status().state;
      assembler_->set_streaming(index, state == CameraState::Streaming || state == CameraState::Opening);
      if (outcome == CaptureOutcome::Delivered) {
        assembler_->push(index, std::move(frame));
        frame = {};
      }
    }
    camera.stop();
  }

  void read_trigger() {
    TriggerEvent event;
    while (!stop_) {
      if (!trigger_->next(event, 50ms)) {
        continue;
      }
      if (event.kind == TriggerEvent::Kind::Fired) {
        assembler_->fired(event.slot, event.actual_ns);
      }
      if (event.slot < kLoggedSlots) {
        log_.events.push_back(event);
      }
    }
  }

  void check_sets() {
    facet::FrameSet set;
    for (;;) {
      const auto outcome = assembler_->next(set, 100ms);
      if (outcome == capture::FrameSetAssembler::Outcome::Closed) {
        return;
      }
      if (outcome != capture::FrameSetAssembler::Outcome::Delivered) {
        continue;
      }
      const std::int64_t now_ns = Clock::now_ns();
      for (std::size_t i = 0; i < set.frames.size(); ++i) {
        const Frame& frame = set.frames[i];
        if (frame.empty()) {
          continue;
        }
        const auto number = read_number(frame);
        if (!number || number->pattern != set.slot % kPatterns) {
          ++wrong_;
          say({{"event", "wrong"},
               {"slot", set.slot},
               {"camera", i},
               {"pattern", number ? json(number->pattern) : json()},
               {"after_trigger_ms", static_cast<double>(frame.timestamp_ns - set.trigger_ns) / 1e6}});
        } else {
          ++right_;
        }
        const std::scoped_lock lock(times_mutex_);
        stamps_ms_.push_back(static_cast<double>(frame.timestamp_ns - set.trigger_ns) / 1e6);
        deliveries_ms_.push_back(static_cast<double>(now_ns - set.trigger_ns) / 1e6);
      }
    }
  }

  void watch_input() {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(options_.seconds);
    while (std::chrono::steady_clock::now() < end) {
      pollfd input{STDIN_FILENO, POLLIN, 0};
      if (::poll(&input, 1, 100) <= 0) {
        continue;
      }
      char letter = 0;
      if (::read(STDIN_FILENO, &letter, 1) != 1) {
        return;
      }
      if (letter == '\n') {
        say_status();
      }
    }
  }

  /// Least, median, 95th percentile and greatest.
  static json spread(std::vector<double> values) {
    if (values.empty()) {
      return json::array();
    }
    std::sort(values.begin(), values.end());
    json result = json::array();
    for (const double part : {0.0, 0.5, 0.95, 1.0}) {
      const double value = values[static_cast<std::size_t>(part * static_cast<double>(values.size() - 1))];
      result.push_back(std::round(value * 100) / 100);
    }
    return result;
  }

  void say_status() {
    const TriggerStatus trigger = trigger_->status();
    const capture::CaptureStatistics sets = assembler_->statistics();
    json line = {{"event", "status"},
                 {"right", right_.load()},
                 {"wrong", wrong_.load()},
                 {"slots_fired", trigger.slots_fired},
                 {"slots_dropped", trigger.slots_dropped},
                 {"edges_late", trigger.edges_late},
                 {"worst_late_ms", static_cast<double>(trigger.worst_late_ns) / 1e6},
                 {"edges_proven", trigger.edges_proven},
                 {"edges_missing", trigger.edges_missing},
                 {"edges_stray", trigger.edges_stray},
                 {"real_time", trigger.real_time},
                 {"trigger", trigger.state == TriggerState::Failing ? trigger.reason : "works"},
                 {"sets_complete", sets.complete},
                 {"sets_incomplete", sets.incomplete},
                 {"sets_dropped", sets.dropped}};
    {
      const std::scoped_lock lock(times_mutex_);
      line["stamp_after_trigger_ms"] = spread(stamps_ms_);
      line["delivery_after_trigger_ms"] = spread(deliveries_ms_);
    }
    for (std::size_t i = 0; i < cameras_.size(); ++i) {
      const CameraStatus status = cameras_[i]->status();
      json camera = {{"state", to_string(status.state)},
                     {"in_sets", sets.cameras[i].in_sets},
                     {"missing", sets.cameras[i].missing}};
      for (const CameraCount& count : kCameraCounts) {
        camera[count.name] = status.counters.*count.value;
      }
      for (std::size_t cause = 0; cause < capture::kRefusals.size(); ++cause) {
        camera[capture::kRefusals[cause]] = sets.cameras[i].refused[cause];
      }
      line["cameras"].push_back(camera);
    }
    say(line);
  }

  Options options_;
  TriggerProgram program_;
  std::vector<std::unique_ptr<Camera>> cameras_;
  std::unique_ptr<capture::FrameSetAssembler> assembler_;
  std::unique_ptr<Trigger> trigger_;
  std::atomic<bool> stop_ = false;
  std::atomic<std::uint64_t> right_ = 0;
  std::atomic<std::uint64_t> wrong_ = 0;
  std::mutex print_mutex_;
  std::mutex times_mutex_;
  std::vector<double> stamps_ms_;      ///< guarded by times_mutex_
  std::vector<double> deliveries_ms_;  ///< guarded by times_mutex_
  trigger::EdgeLog log_;               ///< the trigger's reader's, until it has ended
};

int run(int argc, char** argv) {
  Options options;
  CLI::App app("Frame sets of triggered cameras, checked by what is painted into the pixels");
  app.add_option("--chip", options.chip)->required();
  app.add_option("--camera", options.cameras)->required();
  app.add_option("--rate", options.rate_hz);
  app.add_option("--width", options.width_px);
  app.add_option("--height", options.height_px);
  app.add_option("--seconds", options.seconds);
  app.add_option("--edges", options.edges);
  app.add_flag("!--no-wait", options.wait);
  CLI11_PARSE(app, argc, argv);
  try {
    ClosedLoop(options).run();
  } catch (const Error& error) {
    fmt::print("{}\n", json{{"event", "refused"}, {"error", error.what()}}.dump());
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace facet::hil

int main(int argc, char** argv) {
  return facet::hil::run(argc, argv);
}
