#include "service/status_report.hpp"

#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <system_error>
#include <utility>
#include <vector>

#include "facet/error.hpp"
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

}  // namespace

json to_json(const pipeline::PipelineStatus& status) {
  json stages = json::object();
  for (std::size_t s = 0; s < pipeline::kStages.size(); ++s) {
    stages[pipeline::kStages[s].name] = {{"mean", status.stages[s].mean_ms},
                                         {"p95", status.stages[s].p95_ms}};
  }
  return {
      {"reason", status.reason},
      {"source",
       {{"name", status.source.name},
        {"width_px", status.source.width_px},
        {"height_px", status.source.height_px},
        {"rate_hz", status.source.rate_hz},
        {"live", status.source.live}}},
      {"camera", to_json(status.camera)},
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
      {"stage_ms", std::move(stages)},
      {"photometric_rms", status.photometric_rms},
      {"gpu", status.device},
      {"mesh",
       {{"subjects", status.subjects},
        {"levels", status.levels},
        {"finest_vertices", status.finest_vertices}}},
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
                       {"frames_sent", reader.frames_sent},
                       {"frames_dropped", reader.frames_dropped},
                       {"bytes_sent", reader.bytes_sent}});
  }
  return {{"published", statistics.published},       {"skipped", statistics.skipped},
          {"connections", statistics.connections},   {"refused", statistics.refused},
          {"last_refusal", statistics.last_refusal}, {"readers", std::move(readers)}};
}

json to_json(const take::RecorderStatus& status) {
  return {{"state", take::to_string(status.state)},
          {"reason", status.reason},
          {"file", status.file.string()},
          {"frames", status.frames},
          {"mesh_frames", status.mesh_frames},
          {"dropped", status.dropped},
          {"bytes", status.bytes}};
}

std::uint64_t resident_bytes() {
  std::ifstream statm("/proc/self/statm");
  std::uint64_t total_pages = 0;
  std::uint64_t resident_pages = 0;
  statm >> total_pages >> resident_pages;
  return statm ? resident_pages * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE)) : 0;
}

json list_takes(const std::filesystem::path& folder) {
  struct Found {
    std::filesystem::path file;
    std::filesystem::file_time_type changed;
  };
  std::vector<Found> found;
  std::error_code error;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    std::error_code ignored;
    if (entry->path().extension() == ".take" && entry->is_regular_file(ignored)) {
      found.push_back({entry->path(), entry->last_write_time(ignored)});
    }
  }
  if (error) {
    throw Error(ErrorKind::Storage, folder.string() + ": cannot list this folder: " + error.message());
  }
  std::sort(found.begin(), found.end(), [](const Found& a, const Found& b) { return a.changed > b.changed; });
  json takes = json::array();
  for (const Found& take : found) {
    if (takes.size() == kMostListedTakes) {
      break;
    }
    json entry = {{"name", take.file.stem().string()}, {"file", take.file.string()}};
    try {
      const take::TakeReader reader(take.file);
      const take::TakeInfo& info = reader.info();
      entry["created_utc"] = info.created_utc;
      entry["frames"] = info.frame_count;
      entry["mesh_frames"] = info.mesh_frame_count;
      entry["duration_s"] = static_cast<double>(info.last_timestamp_ns - info.first_timestamp_ns) * 1e-9;
      entry["bytes"] = info.file_bytes;
      entry["closed"] = info.closed;
      entry["end_reason"] = info.end_reason;
    } catch (const Error& unreadable) {
      entry["error"] = unreadable.what();
    }
    takes.push_back(std::move(entry));
  }
  return {{"folder", folder.string()}, {"count", found.size()}, {"takes", std::move(takes)}};
}

}  // namespace facet::service
