// `facet status`: what the daemon does and how fast.

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "commands.hpp"
#include "daemon_options.hpp"
#include "pipeline/status.hpp"

namespace facet::tools {
namespace {

using nlohmann::json;

void print_recording(const json& recording) {
  if (recording.is_null()) {
    fmt::print("recording     nothing\n");
    return;
  }
  fmt::print(
      "recording     {} ({} frames, {} not recorded, {:.1f} MB){}\n", recording["file"].get<std::string>(),
      recording["frames"].get<std::uint64_t>(), recording["dropped"].get<std::uint64_t>(),
      recording["bytes"].get<double>() / 1e6,
      recording["reason"].get<std::string>().empty() ? "" : "; " + recording["reason"].get<std::string>());
}

void print_stages(const json& stages) {
  fmt::print("\n{:<14} {:>9} {:>9}\n", "stage", "mean ms", "p95 ms");
  for (const pipeline::Stage& stage : pipeline::kStages) {
    const double mean_ms = stages[stage.name]["mean"];
    const double p95_ms = stages[stage.name]["p95"];
    if (mean_ms > 0) {
      fmt::print("{:<14} {:>9.2f} {:>9.2f}\n", stage.name, mean_ms, p95_ms);
    }
  }
}

void print_camera(const json& camera) {
  const std::string reason = camera["reason"];
  fmt::print("camera        {}{}\n", camera["state"].get<std::string>(), reason.empty() ? "" : ": " + reason);
  std::vector<std::string> counts;
  for (const CameraCount& count : kCameraCounts) {
    if (const std::uint64_t value = camera["frames"][count.name]; value > 0) {
      counts.push_back(fmt::format("{} {}", value, count.name));
    }
  }
  if (!counts.empty()) {
    fmt::print("              {}\n", fmt::join(counts, ", "));
  }
}

void print(const json& status) {
  const json& source = status["source"];
  const json& frames = status["frames"];
  fmt::print("facetd        {} (process {}), up {:.0f} s, {:.0f} MB in memory\n",
             status["version"].get<std::string>(), status["pid"].get<int>(), status["uptime_s"].get<double>(),
             status["resident_bytes"].get<double>() / 1e6);
  const std::string reason = status["reason"];
  fmt::print("state         {}, {}{}\n", status["state"].get<std::string>(),
             status["tracking"].get<std::string>(), reason.empty() ? "" : ": " + reason);
  fmt::print("source        {} ({} x {} px, {:.2f} Hz{})\n", source["name"].get<std::string>(),
             source["width_px"].get<int>(), source["height_px"].get<int>(), source["rate_hz"].get<double>(),
             source["live"].get<bool>() ? ", live" : "");
  print_camera(status["camera"]);
  const auto count = [&](const char* which) { return frames[which].get<std::uint64_t>(); };
  fmt::print(
      "frames        {} captured, {} dropped, {} handed out: {} with a mesh, {} refined, {} degraded\n",
      count("captured"), count("dropped"), count("processed"), count("mesh"), count("refined"),
      count("degraded"));
  if (count("degraded") > 0) {
    fmt::print("degraded      the last one because: {}\n", status["degraded_reason"].get<std::string>());
  }
  fmt::print("rate          {:.2f} frames per second\n", status["frames_per_second"].get<double>());
  const std::string gpu = status["gpu"];
  fmt::print("gpu           {}\n", gpu.empty() ? "none" : gpu);
  fmt::print("mesh          {} vertices on the finest of {} levels\n",
             status["mesh"]["finest_vertices"].get<int>(), status["mesh"]["levels"].get<int>());
  fmt::print("photometric   {:.4f} mean rms error (linear light, 0 to 1)\n",
             status["photometric_rms"].get<double>());
  fmt::print("stream        {}: {} readers\n", status["stream"]["socket"].get<std::string>(),
             status["stream"]["readers"].size());
  for (const json& reader : status["stream"]["readers"]) {
    fmt::print("              {} (process {}): {} frames sent, {} dropped\n",
               reader["client"].get<std::string>(), reader["pid"].get<int>(),
               reader["frames_sent"].get<std::uint64_t>(), reader["frames_dropped"].get<std::uint64_t>());
  }
  print_recording(status["recording"]);
  print_stages(status["stage_ms"]);
}

}  // namespace

void add_status_command(CLI::App& app) {
  CLI::App* command =
      app.add_subcommand("status", "What the daemon does: state, frames, rate, times per stage, readers");
  const auto options = add_daemon_options(*command);
  const auto as_json = std::make_shared<bool>(false);
  command->add_flag("--json", *as_json, "Print the daemon's answer as JSON");
  command->callback([options, as_json] {
    const json status = call_daemon(*options, "status", json::object());
    if (*as_json) {
      fmt::print("{}\n", status.dump(2));
    } else {
      print(status);
    }
  });
}

}  // namespace facet::tools
