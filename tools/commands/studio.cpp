// `facet studio`: a take in the live face's place on the stream.

#include <fmt/format.h>

#include <chrono>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>

#include "daemon_options.hpp"
#include "facet/error.hpp"
#include "progress.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

struct OpenOptions {
  std::string take;
  bool replay = false;
  bool loop = false;
  int lease_s = 300;
};

void print(const json& studio) {
  const std::string take = studio["take"];
  const std::string reason = studio["reason"];
  if (take.empty()) {
    tell("closed: readers get the live face{}\n", reason.empty() ? "" : " (" + reason + ")");
    return;
  }
  tell("take {}: {}, {} at {:.2f} of {:.2f} s\n", take, studio["state"].get<std::string>(),
       studio["shown"].get<std::string>(), studio["time_s"].get<double>(),
       studio["duration_s"].get<double>());
  const int lease_s = studio["lease_s"];
  tell("{}\n", lease_s > 0 ? fmt::format("closes when nobody wants anything for {} s", lease_s)
                           : std::string("stays until 'facet studio close'"));
  if (!reason.empty()) {
    tell("{}\n", reason);
  }
}

/// Returns once the take is open: until then readers still get the live face.
void open(const DaemonOptions& daemon, const OpenOptions& options) {
  call_daemon(daemon, "studio.open",
              {{"take", options.take}, {"pose", !options.replay}, {"lease_s", options.lease_s}});
  Progress progress("Opening", 0);
  json studio;
  do {
    std::this_thread::sleep_for(100ms);
    studio = call_daemon(daemon, "studio.status");
    progress.set(studio["done"].get<std::uint64_t>());
  } while (studio["state"] == "opening");
  progress.finish();
  if (studio["take"] != options.take) {
    const std::string reason = studio["reason"];
    throw Error(ErrorKind::Usage,
                reason.empty() ? "another client closed it, or opened another take" : reason);
  }
  if (options.replay) {
    call_daemon(daemon, "studio.play", {{"what", "take"}, {"loop", options.loop}});
    studio = call_daemon(daemon, "studio.status");
  }
  print(studio);
}

}  // namespace

void add_studio_command(Command program) {
  const Command command = program.subcommand(
      "studio", "Show a take instead of the live face to all readers and bridges, and let go of it");
  command.requires_subcommand();

  const Command opening = command.subcommand("open", "Open a take of the daemon's folder");
  const auto daemon = add_daemon_options(opening);
  const auto options = std::make_shared<OpenOptions>();
  opening.option("TAKE", options->take, "Its name").required();
  opening.flag("--replay", options->replay,
               "Play it as it was recorded; without, its face stands to be posed");
  opening.flag("--loop", options->loop, "Begin again at the end").needs("--replay");
  opening
      .option("--lease", options->lease_s,
              "Seconds without a wish after which the live face comes back; 0: never by itself")
      .shows_default()
      .range(0, 86'400);
  opening.callback([daemon, options] { open(*daemon, *options); });

  const Command closing = command.subcommand("close", "The live face again");
  closing.callback([daemon = add_daemon_options(closing)] { call_daemon(*daemon, "studio.close"); });

  add_question(command, "status", "What it shows", "studio.status", print);
}

}  // namespace facet::tools
