#include "service/status_report.hpp"

#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>
#include <vector>

#include "booth/rig_check.hpp"
#include "facet/error.hpp"
#include "mesh/arkit.hpp"
#include "take/reader.hpp"

namespace facet::service {

using nlohmann::json;

namespace {

json to_json(const CameraStatus& camera) {
  json counts = json::object();
  for (const CameraCount& count : kCameraCounts) {
    counts[count.name] = camera.counters.*count.value;
  }
  return {{"state", to_string(camera.state)}, {"reason", camera.reason}, {"frames", std::move(counts)}};
}

json to_json(const CameraInfo& info) {
  return {{"name", info.name},
          {"width_px", info.width_px},
          {"height_px", info.height_px},
          {"rate_hz", info.rate_hz},
          {"live", info.live}};
}

json to_json(const capture::CameraMatch& match) {
  json refused = json::object();
  for (std::size_t cause = 0; cause < capture::kRefusals.size(); ++cause) {
    refused[capture::kRefusals.at(cause)] = match.refused.at(cause);
  }
  return {{"in_step", match.in_step},
          {"in_sets", match.in_sets},
          {"missing", match.missing},
          {"refused", std::move(refused)},
          {"offset_us", match.offset_ns * 1e-3},
          {"jitter_us", match.jitter_ns * 1e-3},
          {"worst_us", match.worst_ns * 1e-3},
          {"skew_us", match.skew_ns * 1e-3},
          {"transport_us", match.transport_ns * 1e-3}};
}

json to_json(const TriggerStatus& trigger) {
  return {{"state", to_string(trigger.state)},
          {"reason", trigger.reason},
          {"real_time", trigger.real_time},
          {"scheduling", trigger.scheduling},
          {"slots_fired", trigger.slots_fired},
          {"slots_dropped", trigger.slots_dropped},
          {"edges", trigger.edges},
          {"edges_late", trigger.edges_late},
          {"worst_late_us", static_cast<double>(trigger.worst_late_ns) * 1e-3},
          {"edges_proven", trigger.edges_proven},
          {"edges_missing", trigger.edges_missing},
          {"edges_stray", trigger.edges_stray},
          {"events_lost", trigger.events_lost}};
}

json to_json(const pipeline::DevicesStatus& rig, const std::vector<booth::RigPairStatus>& known) {
  json cameras = json::array();
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    json camera = to_json(rig.cameras[i].status);
    camera["name"] = rig.cameras[i].name;
    camera["source"] = to_json(rig.cameras[i].info);
    camera["sets"] = to_json(rig.sets.cameras.at(i));
    cameras.push_back(std::move(camera));
  }
  json trigger = rig.trigger ? to_json(*rig.trigger) : json(nullptr);
  if (rig.trigger) {
    trigger["opened"] = rig.triggers_opened;
  }
  json pairs = json::array();
  for (const booth::RigPairStatus& pair : known) {
    pairs.push_back({{"left", pair.left},
                     {"right", pair.right},
                     {"matches", pair.matches},
                     {"median_px", pair.median_px},
                     {"p95_px", pair.p95_px},
                     {"problem", pair.wrong},
                     {"columns", booth::RigPairStatus::kColumns},
                     {"error_px", pair.error_px}});
  }
  return {{"cameras", std::move(cameras)},
          {"pairs", std::move(pairs)},
          {"trigger", std::move(trigger)},
          {"sets",
           {{"slots", rig.sets.slots},
            {"complete", rig.sets.complete},
            {"incomplete", rig.sets.incomplete},
            {"dropped", rig.sets.dropped},
            {"odd_slots", rig.sets.odd_slots},
            {"worst_skew_us", static_cast<double>(rig.sets.worst_skew_ns) * 1e-3}}}};
}

json to_json(const pipeline::LearningStatus& learning) {
  return {{"state", to_string(learning.state)},
          {"subject", learning.subject},
          {"note", learning.note},
          {"seen_deg", learning.seen_deg},
          {"turned_left_deg", learning.turned_left_deg},
          {"turned_right_deg", learning.turned_right_deg},
          {"needed_deg", learning.needed_deg},
          {"lamps", learning.lamps},
          {"burst_s", learning.burst_s},
          {"bursts", learning.bursts},
          {"lights", learning.lights}};
}

}  // namespace

json to_json(const pipeline::PipelineStatus& status) {
  json stages = json::object();
  for (std::size_t s = 0; s < pipeline::kStages.size(); ++s) {
    stages[pipeline::kStages[s].name] = {{"mean", status.stages[s].mean_ms},
                                         {"p95", status.stages[s].p95_ms}};
  }
  return {
      {"reason", status.reason},
      {"source", status.rig ? json(nullptr) : to_json(status.source)},
      {"camera", status.rig ? json(nullptr) : to_json(status.camera)},
      {"rig", status.rig ? to_json(*status.rig, status.pairs) : json(nullptr)},
      {"frames",
       {{"captured", status.captured},
        {"dropped", status.dropped},
        {"processed", status.processed},
        {"face", status.face_frames},
        {"mesh", status.mesh_frames},
        {"refined", status.refined_frames},
        {"degraded", status.degraded_frames}}},
      {"frames_per_second", status.frames_per_second},
      {"tracking", mesh::to_string(status.tracking)},
      {"degraded_reason", status.degraded_reason},
      {"given_up", status.given_up},
      {"stage_ms", std::move(stages)},
      {"photometric_rms", status.photometric_rms},
      {"gpu", status.device},
      {"mesh",
       {{"subjects", status.subjects},
        {"levels", status.levels},
        {"finest_vertices", status.finest_vertices}}},
      {"learning", status.learning != nullptr ? to_json(*status.learning) : json(nullptr)},
  };
}

json to_json(const stream::StreamStatistics& statistics) {
  json readers = json::array();
  for (const stream::ReaderStatistics& reader : statistics.readers) {
    readers.push_back({{"id", reader.id},
                       {"client", reader.client},
                       {"pid", reader.pid},
                       {"uid", reader.uid},
                       {"subscribed", reader.subscribed},
                       {"ring", reader.ring},
                       {"web", reader.web},
                       {"frames_sent", reader.frames_sent},
                       {"frames_dropped", reader.frames_dropped},
                       {"bytes_sent", reader.bytes_sent}});
  }
  return {{"published", statistics.published},       {"skipped", statistics.skipped},
          {"connections", statistics.connections},   {"refused", statistics.refused},
          {"last_refusal", statistics.last_refusal}, {"readers", std::move(readers)}};
}

json to_json(const WebStatistics& web) {
  return {{"requests", web.requests},
          {"refused", web.refused},
          {"wrong_tokens", web.wrong_tokens},
          {"broken_off", web.broken_off},
          {"last_refusal", web.last_refusal}};
}

json to_json(const take::RecorderStatus& status) {
  return {{"state", take::to_string(status.state)},
          {"reason", status.reason},
          {"warning", status.warning},
          {"file", status.file.string()},
          {"frames", status.frames},
          {"mesh_frames", status.mesh_frames},
          {"dropped", status.dropped},
          {"bytes", status.bytes},
          {"log_left", status.log_left}};
}

json to_json(const avatar::ValueTuning& tuning) {
  return {{"gain", tuning.gain}, {"dead_zone", tuning.dead_zone}, {"smoothing_ms", tuning.smoothing_ms}};
}

json to_json(const avatar::BridgeStatus& status) {
  json targets = json::array();
  for (const avatar::BridgeTargetStatus& target : status.targets) {
    targets.push_back({{"protocol", avatar::to_string(target.target.protocol)},
                       {"target", target.target.text()},
                       {"asked", target.asked},
                       {"found", target.found},
                       {"name", target.name},
                       {"avatar", target.avatar},
                       {"driven", target.driven ? json(*target.driven) : json()},
                       {"frames", target.frames},
                       {"failed", target.failed},
                       {"reason", target.reason}});
  }
  json values = json::object();
  const avatar::ValueTuning& all = status.values.all;
  if (all != avatar::ValueTuning()) {
    values[avatar::kAllValues] = to_json(all);
  }
  for (const auto& [index, tuning] : status.values.named) {
    if (tuning != all) {
      values[mesh::arkit_name(index)] = to_json(tuning);
    }
  }
  return {{"targets", std::move(targets)},
          {"values", std::move(values)},
          {"answer_reason", status.answer_reason},
          {"find_reason", status.find_reason},
          {"neutral",
           {{"state", avatar::to_string(status.neutral)},
            {"reason", status.neutral_reason},
            {"frames", status.neutral_frames}}}};
}

std::uint64_t resident_bytes() {
  std::ifstream statm("/proc/self/statm");
  std::uint64_t total_pages = 0;
  std::uint64_t resident_pages = 0;
  statm >> total_pages >> resident_pages;
  return statm ? resident_pages * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE)) : 0;
}

}  // namespace facet::service
