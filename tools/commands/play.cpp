// `facet play`: a take on a live socket, as the daemon would stream it.

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include "daemon_options.hpp"
#include "facet/clock.hpp"
#include "facet/error.hpp"
#include "options.hpp"
#include "progress.hpp"
#include "stop_signals.hpp"
#include "stream/server.hpp"
#include "take/reader.hpp"
#include "take_frames.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct PlayOptions {
  std::string take;
  std::string frames;
  std::shared_ptr<StreamOptions> stream;
  double speed = 1;
  bool loop = false;
  bool wait = false;
};

/// Waits until a time; the signal that came meanwhile, or 0.
int sleep_until(Clock::time_point until, const StopSignals& signals) {
  const auto left = std::chrono::duration_cast<std::chrono::nanoseconds>(until - Clock::now()).count();
  if (left <= 0) {
    return signals.pending();
  }
  return signals.wait({left / 1'000'000'000, left % 1'000'000'000});
}

void run_play(const PlayOptions& options) {
  take::TakeReader reader(options.take);
  const auto selection = frames_in_range(reader, options.frames);
  stream::StreamServerConfig config;
  config.socket = options.stream->path();
  config.server_name = fmt::format("facet play {}", FACET_VERSION);
  const StopSignals signals;  // before the server's thread
  stream::StreamServer server(config);
  server.start();
  tell("{}: {} frames on {}{}\n", options.take, selection.size(), config.socket.string(),
       options.loop ? ", until stopped" : "");
  std::fflush(stdout);
  int signal = 0;
  while (options.wait && signal == 0) {
    const auto readers = server.statistics().readers;
    if (std::any_of(readers.begin(), readers.end(), [](const auto& one) { return one.subscribed; })) {
      break;
    }
    signal = sleep_until(Clock::now() + std::chrono::milliseconds(50), signals);
  }
  Progress progress("Playing", options.loop ? 0 : selection.size());
  std::uint64_t sequence = 0;
  do {
    const Clock::time_point begun = Clock::now();
    std::int64_t first_ns = 0;
    std::int64_t last_ns = 0;
    std::int64_t period_ns = 0;
    for (std::size_t k = 0; k < selection.size() && signal == 0; ++k) {
      auto frame = std::make_shared<mesh::MeshFrame>(*reader.frame(selection[k], take::Pictures::Described));
      const std::int64_t media_ns = frame->media_time_ns;
      first_ns = k == 0 ? media_ns : first_ns;
      period_ns = k > 0 ? std::max<std::int64_t>(0, media_ns - last_ns) : period_ns;
      last_ns = std::max(last_ns, media_ns);
      const auto due = begun + std::chrono::nanoseconds(static_cast<std::int64_t>(
                                   static_cast<double>(last_ns - first_ns) / options.speed));
      signal = sleep_until(due, signals);
      frame->images = nullptr;
      frame->origin = mesh::Origin::Take;
      frame->sequence = options.loop ? sequence++ : frame->sequence;
      frame->timestamp_ns = Clock::now_ns();
      if (signal == 0) {
        server.publish(std::move(frame));
        progress.advance();
      }
    }
    if (signal == 0) {  // the last frame stands as long as the one before it
      signal = sleep_until(Clock::now() + std::chrono::nanoseconds(static_cast<std::int64_t>(
                                              static_cast<double>(period_ns) / options.speed)),
                           signals);
    }
  } while (options.loop && signal == 0);
  progress.finish();
  server.request_stop();
  server.stop();
  if (signal != 0) {
    signals.die_of(signal);
  }
}

}  // namespace

void add_play_command(Command app) {
  auto options = std::make_shared<PlayOptions>();
  const Command command =
      app.subcommand("play", "Put a take on a live socket at its rate, as the daemon streams");
  command.option("TAKE", options->take, "Take file").required();
  command.option("--frames", options->frames, kFramesHelp);
  options->stream = add_stream_options(command, "Socket to listen on, where no daemon runs");
  command.option("--speed", options->speed, "Times the take's rate").shows_default().range(0.01, 100.0);
  command.flag("--loop", options->loop, "Begin again at the end, until stopped");
  command.flag("--wait", options->wait, "Begin when the first reader has subscribed");
  command.callback([options] { run_play(*options); });
}

}  // namespace facet::tools
