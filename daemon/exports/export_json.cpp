#include <nlohmann/json.hpp>

#include "exports/export.hpp"

namespace facet::exports {
namespace {

/// Numbers are written as the shortest text that gives the same float.
using Json = nlohmann::basic_json<nlohmann::ordered_map, std::vector, std::string, bool, std::int64_t,
                                  std::uint64_t, float>;

Json camera_json(const CameraIntrinsics& camera) {
  return {{"fx", camera.fx}, {"fy", camera.fy},          {"cx", camera.cx},
          {"cy", camera.cy}, {"width", camera.width_px}, {"height", camera.height_px}};
}

Json pose_json(const Eigen::Isometry3f& pose) {
  Json rows = Json::array();
  for (int row = 0; row < 4; ++row) {
    rows.push_back(
        {pose.matrix()(row, 0), pose.matrix()(row, 1), pose.matrix()(row, 2), pose.matrix()(row, 3)});
  }
  return rows;
}

Json weights_json(const mesh::MeshFrame& frame, const std::vector<float>& weights) {
  Json out = Json::object();
  for (std::size_t i = 0; i < weights.size(); ++i) {
    out[frame.subject->expression_names.at(i)] = weights[i];
  }
  return out;
}

Json stage_json(const mesh::StageTimes& times) {
  return {{"capture", times.capture_ms},     {"detect", times.detect_ms},
          {"landmarks", times.landmarks_ms}, {"fit", times.fit_ms},
          {"upload", times.upload_ms},       {"lighting", times.lighting_ms},
          {"albedo", times.albedo_ms},       {"displacement", times.displacement_ms},
          {"readback", times.readback_ms},   {"latency", times.latency_ms},
          {"depth", times.depth_ms}};
}

Json frame_set_json(const FrameSet& set) {
  Json images = Json::array();
  Json missing = Json::array();
  for (std::size_t i = 0; i < set.frames.size(); ++i) {
    const std::string& name = set.camera_names->at(i);
    if ((set.missing >> i & 1) != 0) {
      missing.push_back(name);
      continue;
    }
    const Frame& frame = set.frames[i];
    images.push_back({{"camera", name},
                      {"sequence", frame.sequence},
                      {"timestamp_ns", frame.timestamp_ns},
                      {"corrupt", frame.corrupt},
                      {"width", frame.width_px},
                      {"height", frame.height_px}});
  }
  return {{"slot", set.slot},
          {"trigger_ns", set.trigger_ns},
          {"skew_ns", set.skew_ns},
          {"light", set.light.empty() ? Json() : Json(set.light)},
          {"missing", std::move(missing)},
          {"images", std::move(images)}};
}

}  // namespace

std::string frame_json(const mesh::MeshFrame& frame, std::int64_t index, const std::string& timecode) {
  const bool meshed = frame.subject != nullptr;
  Json out;
  out["index"] = index;
  out["sequence"] = frame.sequence;
  out["timestamp_ns"] = frame.timestamp_ns;
  out["media_time_ns"] = frame.media_time_ns;
  out["timecode"] = timecode.empty() ? Json(nullptr) : Json(timecode);
  out["state"] = mesh::to_string(frame.state);
  out["origin"] = mesh::to_string(frame.origin);
  out["degraded"] = frame.degraded;
  out["degraded_reason"] = frame.degraded_reason;
  out["camera"] = camera_json(frame.camera);
  out["camera_from_head"] = meshed ? pose_json(frame.camera_from_head) : Json(nullptr);
  out["expression"] = meshed ? weights_json(frame, frame.expression) : Json::object();
  out["expression_confidence"] = meshed ? weights_json(frame, frame.expression_confidence) : Json::object();
  out["avatar_values"] = meshed ? weights_json(frame, frame.avatar_values) : Json::object();
  out["model_weights"] = meshed ? weights_json(frame, frame.model_weights) : Json::object();
  out["identity"] = meshed ? Json(frame.subject->identity) : Json::array();
  out["person"] = meshed && !frame.subject->person.empty() ? Json(frame.subject->person) : Json(nullptr);
  out["lighting"] = meshed ? Json(frame.lighting) : Json::array();
  Json landmarks = Json::array();
  for (const Eigen::Vector2f& point : frame.landmarks_px) {
    landmarks.push_back({point.x(), point.y()});
  }
  out["landmarks_px"] = std::move(landmarks);
  out["reprojection_px"] = frame.reprojection_px;
  out["photometric_rms"] = meshed ? Json(frame.photometric_rms) : Json(nullptr);
  out["stage_ms"] = stage_json(frame.stage_ms);
  if (frame.images != nullptr) {
    out["frame_set"] = frame_set_json(*frame.images);
  }
  // A reason from a driver may hold any bytes.
  return out.dump(-1, ' ', true, Json::error_handler_t::replace);
}

}  // namespace facet::exports
