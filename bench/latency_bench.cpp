// How late the meshes of a running facetd reach a reader: from the frame's time to the reader's hands, over
// the socket or through shared memory, with frames a second and what was dropped.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "facet-client.h"
#include "facet/error.hpp"

namespace {

using Clock = std::chrono::steady_clock;  // CLOCK_MONOTONIC, as frames' times
using facet::Error;
using facet::ErrorKind;

struct Options {
  std::string socket = FACET_DEFAULT_SOCKET;
  double seconds = 10;
  double patience_s = 30;
  bool ring = false;
  std::string json_file;
};

double quantile(const std::vector<double>& sorted, double share) {
  return sorted.empty() ? 0
                        : sorted[static_cast<std::size_t>(share * static_cast<double>(sorted.size() - 1))];
}

double now_ms() {
  return std::chrono::duration<double, std::milli>(Clock::now().time_since_epoch()).count();
}

int run(const Options& options) {
  const std::unique_ptr<facet_client, void (*)(facet_client*)> client(
      facet_client_new(options.socket.c_str(), FACET_DISPLACEMENTS,
                       FACET_RECONNECT | (options.ring ? static_cast<unsigned>(FACET_WANT_RING) : 0U),
                       "latency_bench"),
      facet_client_free);
  if (client == nullptr) {
    throw Error(ErrorKind::Usage, fmt::format("{} is no socket's path", options.socket));
  }
  std::vector<double> late_ms;
  std::vector<double> pipeline_ms;
  std::uint64_t first = 0;
  std::uint64_t last = 0;
  std::size_t meshes = 0;
  std::size_t degraded = 0;
  std::string why;
  double begin_ms = now_ms() + 1e3 * options.patience_s;  // until the first mesh: when patience ends
  double end_ms = begin_ms;
  double newest_ms = 0;
  while (now_ms() < end_ms) {
    constexpr int kTurnMs = 100;
    if (facet_client_next(client.get(), kTurnMs) != FACET_OK) {
      continue;
    }
    const facet_frame& frame = *facet_client_frame(client.get());
    const double at_ms = now_ms();
    if (frame.subject_id == 0) {
      continue;
    }
    if (meshes == 0) {  // came with the topology
      first = frame.sequence;
      begin_ms = at_ms;
      end_ms = at_ms + 1e3 * options.seconds;
    } else {
      late_ms.push_back(at_ms - 1e-6 * static_cast<double>(frame.timestamp_ns));
      pipeline_ms.push_back(static_cast<double>(frame.latency_ms));
    }
    ++meshes;
    degraded += frame.degraded != 0 ? 1 : 0;
    why = frame.degraded != 0 ? frame.degraded_reason : why;
    last = frame.sequence;
    newest_ms = at_ms;
  }
  if (meshes < 2) {
    throw Error(
        ErrorKind::Unavailable,
        fmt::format("{}: {} in {:.0f} s ({})", options.socket, meshes == 0 ? "no mesh" : "one mesh",
                    meshes == 0 ? options.patience_s : options.seconds, facet_client_message(client.get())));
  }
  std::sort(late_ms.begin(), late_ms.end());
  std::sort(pipeline_ms.begin(), pipeline_ms.end());
  const facet_statistics& statistics = *facet_client_statistics(client.get());
  const double hz = 1e3 * static_cast<double>(late_ms.size()) / (newest_ms - begin_ms);
  nlohmann::json out{{"way", statistics.by_ring != 0 ? "ring" : "socket"},
                     {"meshes", meshes},
                     {"frames_passed", last - first + 1},
                     {"frames_per_second", hz},
                     {"degraded", degraded},
                     {"degraded_reason", why},
                     {"dropped_by_reader", statistics.dropped},
                     {"late_ms_median", quantile(late_ms, 0.5)},
                     {"late_ms_p99", quantile(late_ms, 0.99)},
                     {"late_ms_worst", late_ms.back()},
                     {"pipeline_ms_median", quantile(pipeline_ms, 0.5)},
                     {"pipeline_ms_p99", quantile(pipeline_ms, 0.99)}};
  fmt::print(
      "{}: {:.1f} meshes a second, {} of {} frames, {} degraded{}{}; from the frame to the reader median "
      "{:.1f} ms, "
      "99 % {:.1f}, worst {:.1f}; within facetd median {:.1f}, 99 % {:.1f}\n",
      out["way"].get<std::string>(), hz, meshes, last - first + 1, degraded, why.empty() ? "" : ": ", why,
      quantile(late_ms, 0.5), quantile(late_ms, 0.99), late_ms.back(), quantile(pipeline_ms, 0.5),
      quantile(pipeline_ms, 0.99));
  if (!options.json_file.empty()) {
    std::ofstream file(options.json_file);
    file << out.dump(2) << '\n';
    if (!file.flush()) {
      throw Error(ErrorKind::Storage, fmt::format("cannot write {}", options.json_file));
    }
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("How late the meshes of a running facetd reach a reader");
  app.add_option("--socket", options.socket, "stream socket")->capture_default_str();
  app.add_option("--seconds", options.seconds, "from the first mesh on")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--patience", options.patience_s, "seconds to wait for the first mesh")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_flag("--ring", options.ring, "through shared memory, where facetd offers it");
  app.add_option("--json", options.json_file, "the figures as JSON, to this file");
  CLI11_PARSE(app, argc, argv);
  try {
    return run(options);
  } catch (const Error& error) {
    fmt::print(stderr, "latency_bench: {}\n", error.what());
    return static_cast<int>(error.kind());
  }
}
