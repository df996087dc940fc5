// `facet record`, `neutral`, `reset-identity`, `shutdown`: what a running daemon is asked for.

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>

#include "daemon_options.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "progress.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

void print_stopped(const json& take) {
  tell("{}: {} frames, {} not recorded, {:.1f} MB\n", take["file"].get<std::string>(),
       take["frames"].get<std::uint64_t>(), take["dropped"].get<std::uint64_t>(),
       take["bytes"].get<double>() / 1e6);
  if (take["state"] == "finished" && take.value("log_left", false)) {
    tell(stderr,
         "note: a part of it stays in the -wal file beside it, as another program reads the take: "
         "end that, then 'facet summary --close' makes one file of it\n");
  }
  if (const std::string warning = take.value("warning", ""); !warning.empty()) {
    tell(stderr, "warning: {}; look at it with 'facet summary --verify', and at the disk\n", warning);
  }
  if (const std::string reason = take["reason"]; take["state"] == "finished" && !reason.empty()) {
    tell(stderr, "note: it had ended before: {}\n", reason);
  }
  if (take["state"] == "failed") {
    throw Error(ErrorKind::Storage,
                "the recording had ended by itself: " + take["reason"].get<std::string>());
  }
}

/// Frames come late, and the file is written after the last.
constexpr auto kPatience = 10s;

void record_neutral(const DaemonOptions& options, double seconds) {
  call_daemon(options, "neutral.record", {{"seconds", seconds}});
  const auto tenths = static_cast<std::uint64_t>(10 * seconds);
  const auto end = Clock::now() + std::chrono::duration<double>(seconds) + kPatience;
  Progress progress("Look straight ahead, the face at rest", tenths, "tenths of a second");
  json neutral;
  std::uint64_t passed = 0;
  do {
    std::this_thread::sleep_for(100ms);
    neutral = call_daemon(options, "status")["bridges"]["neutral"];
    progress.set(std::min(++passed, tenths));
  } while (neutral["state"] == "recording" && Clock::now() < end);
  progress.finish();
  if (neutral["state"] != "set") {
    throw Error(neutral["frames"] == 0 ? ErrorKind::NoFace : ErrorKind::Unavailable,
                fmt::format("no neutral pose: {}", neutral["reason"].get<std::string>()));
  }
  tell("neutral pose of {} frames\n", neutral["frames"].get<int>());
}

/// A subcommand that asks for something and says nothing.
void add_request(Command program, const std::string& name, const std::string& help,
                 const std::string& method) {
  const Command command = program.subcommand(name, help);
  command.callback([options = add_daemon_options(command), method] { call_daemon(*options, method); });
}

}  // namespace

void add_record_command(Command program) {
  const Command command = program.subcommand("record", "Record a take of the running daemon");
  command.requires_subcommand();

  const Command start = command.subcommand("start", "Begin a take with the next frame");
  const auto start_options = add_daemon_options(start);
  const auto name = std::make_shared<std::string>();
  start.option("name", *name, "Name of the take (default: the time, UTC)");
  start.callback([start_options, name] {
    const json params = name->empty() ? json::object() : json{{"name", *name}};
    tell("{}\n", call_daemon(*start_options, "record.start", params)["file"].get<std::string>());
  });

  const Command stop = command.subcommand("stop", "End the take and close its file");
  const auto stop_options = add_daemon_options(stop);
  stop.callback([stop_options] { print_stopped(call_daemon(*stop_options, "record.stop")); });
}

void add_neutral_command(Command program) {
  const Command command =
      program.subcommand("neutral", "Record the resting face and the straight look that avatars count from");
  const auto options = add_daemon_options(command);
  const auto seconds = std::make_shared<double>(1.0);
  const auto clear = std::make_shared<bool>(false);
  command.option("--seconds", *seconds, "How long").shows_default().range(0.1, 60.0);
  command.flag("--clear", *clear, "Forget it instead");
  command.callback([options, seconds, clear] {
    if (*clear) {
      call_daemon(*options, "neutral.clear");
    } else {
      record_neutral(*options, *seconds);
    }
  });
}

void add_reset_identity_command(Command program) {
  add_request(program, "reset-identity",
              "Let the daemon estimate identity and focal length anew from the next good frames",
              "identity.reset");
}

void add_shutdown_command(Command program) {
  add_request(program, "shutdown", "End the running daemon; a take in progress is closed", "shutdown");
}

}  // namespace facet::tools
