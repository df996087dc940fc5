// `facet record start [NAME]` and `facet record stop`: takes of the running daemon.

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "daemon_options.hpp"
#include "facet/error.hpp"
#include "tell.hpp"

namespace facet::tools {

using nlohmann::json;

void add_record_command(Command app) {
  const Command command = app.subcommand("record", "Record a take of the running daemon");
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
  stop.callback([stop_options] {
    const json take = call_daemon(*stop_options, "record.stop", json::object());
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
  });
}

}  // namespace facet::tools
