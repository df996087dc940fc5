// `facet neutral`: the resting face of who sits there, taken away from what the bridges send.

#include <fmt/format.h>

#include <chrono>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>

#include "commands.hpp"
#include "daemon_options.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "progress.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

/// Frames come late, and the file is written after the last.
constexpr auto kPatience = 10s;

void record(const DaemonOptions& options, double seconds) {
  call_daemon(options, "neutral.record", {{"seconds", seconds}});
  const auto tenths = static_cast<std::uint64_t>(10 * seconds);
  const auto end = Clock::now() + std::chrono::duration<double>(seconds) + kPatience;
  Progress progress("Look straight ahead, the face at rest", tenths, "tenths of a second");
  json neutral;
  do {
    std::this_thread::sleep_for(100ms);
    neutral = call_daemon(options, "status", json::object())["bridges"]["neutral"];
    progress.advance();
  } while (neutral["state"] == "recording" && Clock::now() < end);
  progress.finish();
  if (neutral["state"] != "set") {
    throw Error(neutral["frames"] == 0 ? ErrorKind::NoFace : ErrorKind::Unavailable,
                fmt::format("no neutral pose: {}", neutral["reason"].get<std::string>()));
  }
  tell("neutral pose of {} frames\n", neutral["frames"].get<int>());
}

}  // namespace

void add_neutral_command(Command app) {
  const Command command = app.subcommand(
      "neutral", "Record the resting face and the straight look that the daemon's bridges count from");
  const auto options = add_daemon_options(command);
  const auto seconds = std::make_shared<double>(1.0);
  const auto clear = std::make_shared<bool>(false);
  command.option("--seconds", *seconds, "How long").shows_default().range(0.1, 60.0);
  command.flag("--clear", *clear, "Forget it instead");
  command.callback([options, seconds, clear] {
    if (*clear) {
      call_daemon(*options, "neutral.clear", json::object());
    } else {
      record(*options, *seconds);
    }
  });
}

}  // namespace facet::tools
