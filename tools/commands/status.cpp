// `facet status`: what the daemon does and how fast.

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "daemon_options.hpp"
#include "pipeline/status.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

using nlohmann::json;

void print_recording(const json& recording) {
  if (recording.is_null()) {
    tell("recording     nothing\n");
    return;
  }
  tell("recording     {}{} ({} frames, {} not recorded, {:.1f} MB){}\n",
       recording["state"] == "failed" ? "nothing; ended by itself: " : "",
       recording["file"].get<std::string>(), recording["frames"].get<std::uint64_t>(),
       recording["dropped"].get<std::uint64_t>(), recording["bytes"].get<double>() / 1e6,
       recording["reason"].get<std::string>().empty() ? "" : "; " + recording["reason"].get<std::string>());
}

void print_bridges(const json& bridges) {
  for (const json& target : bridges["targets"]) {
    const std::string reason = target["reason"];
    tell("bridge        {} to {}: {} frames, {} failed{}\n", target["protocol"].get<std::string>(),
         target["target"].get<std::string>(), target["frames"].get<std::uint64_t>(),
         target["failed"].get<std::uint64_t>(), reason.empty() ? "" : ": " + reason);
    if (const std::string name = target.value("name", std::string()); !name.empty()) {
      const json driven = target.value("driven", json());
      tell("              {}, {}\n", name,
           driven.is_null() ? "which does not tell what its avatar has: everything is sent"
                            : fmt::format("avatar {}: {} of its parameters are driven",
                                          target.value("avatar", std::string()), driven.get<int>()));
    }
  }
  for (const char* key : {"answer_reason", "find_reason"}) {
    if (const std::string fault = bridges.value(key, std::string()); !fault.empty()) {
      tell("bridges       {}\n", fault);
    }
  }
  const std::string reason = bridges["neutral"]["reason"];
  tell("neutral pose  {}{}\n", bridges["neutral"]["state"].get<std::string>(),
       reason.empty() ? "" : ": " + reason);
  const json values = bridges.value("values", json::object());
  if (const std::size_t named = values.size() - values.count("all"); !values.empty()) {
    tell("tuned values  {}{} ('facet values' lists them)\n", named,
         values.contains("all") ? ", and all others" : "");
  }
}

void print_studio(const json& studio) {
  if (studio.is_null()) {
    return;
  }
  const std::string take = studio["take"];
  const std::string reason = studio["reason"];
  if (take.empty()) {
    if (!reason.empty()) {
      tell("studio        closed: {}\n", reason);
    }
    return;
  }
  const auto lease_s = studio.value("lease_s", 0);
  tell("studio        SHOWS TAKE {} INSTEAD OF THE LIVE FACE ({}, {}); {}{}\n", take,
       studio["state"].get<std::string>(), studio["shown"].get<std::string>(),
       lease_s > 0 ? fmt::format("closes {} s after the last wish", lease_s)
                   : std::string("until 'facet studio close'"),
       reason.empty() ? "" : "; " + reason);
}

void print_stages(const json& stages) {
  tell("\n{:<14} {:>9} {:>9}\n", "stage", "mean ms", "p95 ms");
  for (const pipeline::Stage& stage : pipeline::kStages) {
    const double mean_ms = stages[stage.name]["mean"];
    const double p95_ms = stages[stage.name]["p95"];
    if (mean_ms > 0) {
      tell("{:<14} {:>9.2f} {:>9.2f}\n", stage.name, mean_ms, p95_ms);
    }
  }
}

void print_source(const json& source) {
  tell("source        {} ({} x {} px, {:.2f} Hz{})\n", source["name"].get<std::string>(),
       source["width_px"].get<int>(), source["height_px"].get<int>(), source["rate_hz"].get<double>(),
       source["live"].get<bool>() ? ", live" : "");
}

/// name: of a rig's camera, with a colon.
void print_camera(const json& camera, const std::string& name = "") {
  const std::string reason = camera["reason"];
  tell("camera        {}{}{}\n", name, camera["state"].get<std::string>(),
       reason.empty() ? "" : ": " + reason);
  std::vector<std::string> counts;
  for (const CameraCount& count : kCameraCounts) {
    if (const std::uint64_t value = camera["frames"][count.name]; value > 0) {
      counts.push_back(fmt::format("{} {}", value, count.name));
    }
  }
  if (!counts.empty()) {
    tell("              {}\n", fmt::format("{}", fmt::join(counts, ", ")));
  }
}

void print_match(const json& sets) {
  std::string refused;
  for (const auto& [cause, count] : sets["refused"].items()) {
    if (count.get<std::uint64_t>() > 0) {
      refused +=
          fmt::format("{} {} {}", refused.empty() ? "; refused" : ",", count.get<std::uint64_t>(), cause);
    }
  }
  tell("              {}: in {} sets, missing in {}{}\n",
       sets["in_step"].get<bool>() ? "in step" : "OUT OF STEP", sets["in_sets"].get<std::uint64_t>(),
       sets["missing"].get<std::uint64_t>(), refused);
  tell("              {:.0f} us behind the trigger, jitter {:.0f} us, {:.1f} ms on the way\n",
       sets["offset_us"].get<double>(), sets["jitter_us"].get<double>(),
       sets["transport_us"].get<double>() / 1000);
}

void print_trigger(const json& trigger) {
  if (trigger.is_null()) {
    tell("trigger       none: the cameras run freely\n");
    return;
  }
  const auto count = [&](const char* which) { return trigger[which].get<std::uint64_t>(); };
  const std::string reason = trigger["reason"];
  tell("trigger       {}{}\n", trigger["state"].get<std::string>(), reason.empty() ? "" : ": " + reason);
  tell("              {} slots fired, {} dropped; {} edges, {} late (worst {:.0f} us)\n",
       count("slots_fired"), count("slots_dropped"), count("edges"), count("edges_late"),
       trigger["worst_late_us"].get<double>());
  if (count("edges_proven") + count("edges_missing") + count("edges_stray") > 0) {
    tell("              read back: {} edges proven, {} missing, {} stray\n", count("edges_proven"),
         count("edges_missing"), count("edges_stray"));
  }
  tell("              scheduling: {}\n", trigger["scheduling"].get<std::string>());
}

void print_rig(const json& rig) {
  for (const json& camera : rig["cameras"]) {
    print_camera(camera, camera["name"].get<std::string>() + ": ");
    print_match(camera["sets"]);
  }
  print_trigger(rig["trigger"]);
  const json& sets = rig["sets"];
  const auto count = [&](const char* which) { return sets[which].get<std::uint64_t>(); };
  tell("frame sets    {} slots: {} complete, {} incomplete, {} dropped; worst skew {:.0f} us\n",
       count("slots"), count("complete"), count("incomplete"), count("dropped"),
       sets["worst_skew_us"].get<double>());
}

/// What only meshes have.
void print_refinement(const json& status) {
  const std::string gpu = status["gpu"];
  tell("gpu           {}\n", gpu.empty() ? "none" : gpu);
  tell("mesh          {} vertices on the finest of {} levels\n", status["mesh"]["finest_vertices"].get<int>(),
       status["mesh"]["levels"].get<int>());
  if (const std::string given_up = status["given_up"]; !given_up.empty()) {
    tell("given up      {}\n", given_up);
  }
  if (const json learning = status.value("learning", json()); learning.is_object()) {
    const std::string note = learning["note"];
    tell("own shape     {}; the head turned {:.0f} degrees to its left, {:.0f} to its right{}\n",
         learning["state"].get<std::string>(), learning["turned_left_deg"].get<double>(),
         learning["turned_right_deg"].get<double>(), note.empty() ? "" : ": " + note);
  }
  tell("photometric   {:.4f} mean rms error (linear light, 0 to 1)\n",
       status["photometric_rms"].get<double>());
}

void print(const json& status) {
  const bool of_rig = !status["rig"].is_null();
  const bool tracks = !of_rig || status.value("mode", "") == "monocular";
  const json& frames = status["frames"];
  tell("facetd        {} (process {}), up {:.0f} s, {:.0f} MB in memory\n",
       status["version"].get<std::string>(), status["pid"].get<int>(), status["uptime_s"].get<double>(),
       status["resident_bytes"].get<double>() / 1e6);
  const std::string reason = status["reason"];
  tell("state         {}{}{}\n", status["state"].get<std::string>(),
       tracks ? ", " + status["tracking"].get<std::string>() : "", reason.empty() ? "" : ": " + reason);
  if (of_rig) {
    print_rig(status["rig"]);
  } else {
    print_source(status["source"]);
    print_camera(status["camera"]);
  }
  const auto count = [&](const char* which) { return frames[which].get<std::uint64_t>(); };
  tell("frames        {} captured, {} dropped, {} handed out: {} with a mesh, {} refined, {} degraded\n",
       count("captured"), count("dropped"), count("processed"), count("mesh"), count("refined"),
       count("degraded"));
  if (count("degraded") > 0) {
    tell("degraded      the last one because: {}\n", status["degraded_reason"].get<std::string>());
  }
  tell("rate          {:.2f} frames per second\n", status["frames_per_second"].get<double>());
  if (tracks) {
    print_refinement(status);
  }
  tell("stream        {}: {} readers\n", status["stream"]["socket"].get<std::string>(),
       status["stream"]["readers"].size());
  for (const json& reader : status["stream"]["readers"]) {
    const std::string by = reader.value("web", false)
                               ? " (over the web)"
                               : fmt::format(" (process {}){}", reader["pid"].get<int>(),
                                             reader.value("ring", false) ? ", by ring" : "");
    tell("              {}{}: {} frames sent, {} dropped\n", reader["client"].get<std::string>(), by,
         reader["frames_sent"].get<std::uint64_t>(), reader["frames_dropped"].get<std::uint64_t>());
  }
  if (const json web = status.value("web", json()); web.is_object()) {
    const std::string refusal = web["last_refusal"];
    tell("web           {}: {} requests, {} refused{}\n", web["url"].get<std::string>(),
         web["requests"].get<std::uint64_t>(), web["refused"].get<std::uint64_t>(),
         refusal.empty() ? "" : ", the last: " + refusal);
  }
  print_studio(status.value("studio", json()));
  print_bridges(status["bridges"]);
  print_recording(status["recording"]);
  print_stages(status["stage_ms"]);
}

}  // namespace

void add_status_command(Command program) {
  add_question(program, "status", "What the daemon does: state, frames, rate, times per stage, readers",
               "status", print);
}

}  // namespace facet::tools
