// `facet takes`: the takes of a running daemon's folder, listed and taken care of.

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

#include "daemon_options.hpp"
#include "facet/error.hpp"
#include "progress.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

/// Slate and note in a line, as far as there are any.
std::string written_to(const json& take) {
  std::string words;
  if (take.contains("slate")) {
    words = fmt::format("  slate {}/{}", take["slate"]["scene"].get<std::string>(),
                        take["slate"]["take"].get<std::string>());
  }
  if (take.contains("note")) {
    constexpr std::size_t kMostShown = 60;
    std::string note = take["note"];
    const std::size_t end = note.find('\n');
    const bool is_cut = end != std::string::npos || note.size() > kMostShown;
    note = note.substr(0, std::min(end, kMostShown));
    words += fmt::format("  \"{}{}\"", note, is_cut ? " ..." : "");
  }
  return words;
}

void print_takes(const json& list) {
  const auto count = list["count"].get<std::size_t>();
  tell("{} {} in {}\n", count, count == 1 ? "take" : "takes", list["folder"].get<std::string>());
  if (list["takes"].empty()) {
    return;
  }
  tell("{:<32} {:<21} {:>8} {:>8} {:>9} {:>9}\n", "name", "recorded (UTC)", "frames", "meshes", "seconds",
       "MB");
  for (const json& take : list["takes"]) {
    const std::string name = take["name"];
    if (take.contains("error")) {
      tell("{:<32} {}\n", name, take["error"].get<std::string>());
      continue;
    }
    const std::string end_reason = take["end_reason"];
    tell("{:<32} {:<21} {:>8} {:>8} {:>9.1f} {:>9.1f}{}{}\n", name, take["created_utc"].get<std::string>(),
         take["frames"].get<std::int64_t>(), take["mesh_frames"].get<std::int64_t>(),
         take["duration_s"].get<double>(), take["bytes"].get<double>() / 1e6,
         !end_reason.empty()           ? "  ended: " + end_reason
         : !take["closed"].get<bool>() ? "  not closed"
                                       : "",
         written_to(take));
  }
  if (list["count"].get<std::size_t>() > list["takes"].size()) {
    tell("(the newest {} are shown)\n", list["takes"].size());
  }
}

struct ListOptions {
  bool as_json = false;
  bool asked = false;  ///< a subcommand was: the parent's callback runs after it
};

void list(const DaemonOptions& daemon, const ListOptions& options) {
  const json answer = call_daemon(daemon, "takes.list");
  if (options.as_json) {
    std::puts(answer.dump(2, ' ', true).c_str());
  } else {
    print_takes(answer);
  }
}

struct DeleteOptions {
  std::string name;
  bool now = false;
  bool yes = false;
};

/// The answer to a question on the terminal; where there is none, the take stays.
bool confirmed(const std::string& name) {
  if (::isatty(STDIN_FILENO) == 0) {
    throw Error(ErrorKind::Usage,
                fmt::format("take '{}' is not deleted: there is no terminal to ask on; give --yes", name));
  }
  tell("Delete {} for good? It can't be had back. [y/N] ", name);
  std::fflush(stdout);
  const int answer = std::getchar();
  return answer == 'y' || answer == 'Y';
}

void remove(const DaemonOptions& daemon, const DeleteOptions& options) {
  if (options.now && !options.yes && !confirmed(options.name)) {
    tell("kept\n");
    return;
  }
  const json answer = call_daemon(daemon, "takes.delete", {{"name", options.name}, {"now", options.now}});
  if (answer["gone"].get<bool>()) {
    tell(
        "take {} is deleted for good, {:.1f} MB, with its pictures and all that was made of it in the takes' "
        "folder. Copies elsewhere, exports and trims of it are not\n",
        options.name, answer["bytes"].get<double>() / 1e6);
  } else {
    tell("take {} is deleted. Until {} it can be had back: facet takes restore '{}'\n", options.name,
         answer["kept_until_utc"].get<std::string>(), options.name);
  }
}

void print_deleted(const json& answer) {
  if (answer["takes"].empty()) {
    tell("no deleted takes\n");
  }
  for (const json& take : answer["takes"]) {
    tell("{:<32} deleted {}, kept until {}\n", take["name"].get<std::string>(),
         take["deleted_utc"].get<std::string>(), take["kept_until_utc"].get<std::string>());
  }
}

/// Each text is empty where it is not given; a given one may be "".
struct NoteOptions {
  std::string name;
  std::vector<std::string> note;
  std::vector<std::string> scene;
  std::vector<std::string> number;
};

void note(const DaemonOptions& daemon, const NoteOptions& options) {
  json params = {{"name", options.name}};
  if (!options.note.empty()) {
    params["note"] = options.note.front();
  }
  if (!options.scene.empty()) {
    params["slate"]["scene"] = options.scene.front();
  }
  if (!options.number.empty()) {
    params["slate"]["take"] = options.number.front();
  }
  const json answer = call_daemon(daemon, "takes.note", params);
  tell("slate {}/{}\n{}\n", answer["slate"]["scene"].get<std::string>(),
       answer["slate"]["take"].get<std::string>(), answer["note"].get<std::string>());
}

struct TrimOptions {
  std::string name;
  double from_s = 0;
  double to_s = 0;
  std::string to;
};

/// Returns once the new take is there.
void trim(const DaemonOptions& daemon, const TrimOptions& options) {
  const json begun = call_daemon(
      daemon, "takes.trim",
      {{"name", options.name}, {"from_s", options.from_s}, {"to_s", options.to_s}, {"to", options.to}});
  Progress progress("Trimming", begun["frames"].get<std::uint64_t>());
  json now;
  do {
    std::this_thread::sleep_for(100ms);
    now = call_daemon(daemon, "status")["takes"]["trim"];
    progress.set(now["done"].get<std::uint64_t>());
  } while (now["state"] == "working" && now["to"] == options.to);
  progress.finish();
  if (now["to"] != options.to || now["state"] != "done") {
    const std::string reason = now["reason"];
    throw Error(ErrorKind::Unavailable,
                fmt::format("take '{}' was not trimmed: {}", options.name,
                            now["to"] != options.to ? "another client trims already: see 'facet takes'"
                            : reason.empty()        ? "it was broken off"
                                                    : reason));
  }
  tell("{}: {} frames\n", begun["file"].get<std::string>(), begun["frames"].get<std::uint64_t>());
}

/// A subcommand for one take, which the list is not printed after.
template <typename Options>
Command add_one(Command parent, const std::string& name, const std::string& help,
                const std::shared_ptr<Options>& options) {
  const Command command = parent.subcommand(name, help);
  command.option("NAME", options->name, "Its name").required();
  return command;
}

struct NamedOptions {
  std::string name;
  std::string to;
};

void add_renaming(Command parent, const std::shared_ptr<ListOptions>& listing) {
  const auto renamed = std::make_shared<NamedOptions>();
  const Command renaming = add_one(parent, "rename", "Give a take another name", renamed);
  renaming.option("TO", renamed->to, "The new name").required();
  renaming.callback([daemon = add_daemon_options(renaming), renamed, listing] {
    listing->asked = true;
    const json answer = call_daemon(*daemon, "takes.rename", {{"name", renamed->name}, {"to", renamed->to}});
    tell("{}\n", answer["file"].get<std::string>());
  });

  const auto restored = std::make_shared<NamedOptions>();
  const Command restoring = add_one(parent, "restore", "Bring a deleted take back", restored);
  restoring.option("--to", restored->to, "Its name then, where there is a take of its name again");
  restoring.callback([daemon = add_daemon_options(restoring), restored, listing] {
    listing->asked = true;
    json params = {{"name", restored->name}};
    if (!restored->to.empty()) {
      params["to"] = restored->to;
    }
    tell("{}\n", call_daemon(*daemon, "takes.restore", params)["file"].get<std::string>());
  });
}

void add_deleting(Command parent, const std::shared_ptr<ListOptions>& listing) {
  const auto options = std::make_shared<DeleteOptions>();
  const Command deleting =
      add_one(parent, "delete", "Delete a take; for seven days 'restore' brings it back", options);
  deleting.flag(
      "--now", options->now,
      "For good, at once, with what of its name was deleted before: the way to remove a person's face");
  deleting.flag("--yes", options->yes, "Do not ask").needs("--now");
  deleting.callback([daemon = add_daemon_options(deleting), options, listing] {
    listing->asked = true;
    remove(*daemon, *options);
  });

  const Command deleted = parent.subcommand("deleted", "List what 'restore' brings back");
  deleted.callback([daemon = add_daemon_options(deleted), listing] {
    listing->asked = true;
    print_deleted(call_daemon(*daemon, "takes.deleted"));
  });

  const auto purged = std::make_shared<std::string>();
  const Command purging = parent.subcommand("purge", "Remove deleted takes for good");
  purging.option("NAME", *purged, "Of this name alone");
  purging.callback([daemon = add_daemon_options(purging), purged, listing] {
    listing->asked = true;
    const json answer =
        call_daemon(*daemon, "takes.purge", purged->empty() ? json::object() : json{{"name", *purged}});
    tell("{} takes are removed for good, {:.1f} MB\n", answer["takes"].get<int>(),
         answer["bytes"].get<double>() / 1e6);
  });
}

}  // namespace

void add_takes_command(Command program) {
  const Command command = program.subcommand(
      "takes", "List the takes in the daemon's folder, newest first; rename, delete, note and trim them");
  const auto daemon = add_daemon_options(command);
  const auto listing = std::make_shared<ListOptions>();
  command.flag("--json", listing->as_json, "Print the daemon's answer as JSON");
  command.callback([daemon, listing] {
    if (!listing->asked) {
      list(*daemon, *listing);
    }
  });

  const auto alone = std::make_shared<ListOptions>();
  const Command all = command.subcommand("list", "The same as no subcommand");
  all.flag("--json", alone->as_json, "Print the daemon's answer as JSON");
  all.callback([daemon = add_daemon_options(all), alone, listing] {
    listing->asked = true;
    list(*daemon, *alone);
  });

  add_renaming(command, listing);
  add_deleting(command, listing);

  const auto noted = std::make_shared<NoteOptions>();
  const Command noting =
      add_one(command, "note", "Write to a take; what is not given stays, \"\" removes", noted);
  noting.option("--note", noted->note, "Free text, 2000 characters at most").expected(1);
  noting.option("--scene", noted->scene, "The slate's scene").expected(1);
  noting.option("--take", noted->number, "The slate's number of the take").expected(1);
  noting.callback([daemon = add_daemon_options(noting), noted, listing] {
    listing->asked = true;
    note(*daemon, *noted);
  });

  const auto trimmed = std::make_shared<TrimOptions>();
  const Command trimming =
      add_one(command, "trim", "Make a new take of a part of one, which stays as it is", trimmed);
  trimming.option("TO", trimmed->to, "Name of the new take").required();
  trimming.option("--from", trimmed->from_s, "Seconds, as a replay counts them").shows_default();
  trimming.option("--until", trimmed->to_s, "Seconds, likewise").required();
  trimming.callback([daemon = add_daemon_options(trimming), trimmed, listing] {
    listing->asked = true;
    trim(*daemon, *trimmed);
  });
}

}  // namespace facet::tools
