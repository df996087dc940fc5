#include "pipeline/live_cameras.hpp"

#include <algorithm>
#include <utility>

#include "capture/rig_file.hpp"
#include "facet/error.hpp"

namespace facet::pipeline {

void LiveSets::deliver(std::shared_ptr<const FrameSet> set) {
  newest_.push_newest(std::move(set));
}

CaptureOutcome LiveSets::next(FrameSet& out, std::chrono::milliseconds timeout) {
  using namespace std::chrono_literals;
  std::shared_ptr<const FrameSet> set;
  if (!newest_.pop_within(set, timeout)) {
    if (!ended_()) {
      return CaptureOutcome::Timeout;
    }
    // The last one may have come meanwhile.
    if (!newest_.pop_within(set, 0ms)) {
      return CaptureOutcome::EndOfStream;
    }
  }
  out = pictures_of(*set, cameras_);
  return CaptureOutcome::Delivered;
}

void check(const DevicesConfig& devices, const std::filesystem::path& rig_file) {
  check(devices);
  if (rig_file.empty()) {
    throw Error(ErrorKind::Usage,
                "rig.file is missing: several cameras see one face only where they are calibrated; name the "
                "file that `facet calibrate` wrote (docs/cameras.md)");
  }
  const std::vector<LineMask>& patterns = devices.program.patterns;
  if (devices.trigger != TriggerKind::None &&
      std::any_of(patterns.begin(), patterns.end(), [&](LineMask one) { return one != patterns.front(); })) {
    throw Error(ErrorKind::Usage,
                "mode \"monocular\" makes a mesh of every slot, and its light must be the same in all: leave "
                "trigger.patterns out, or set mode = \"booth\"");
  }
}

std::vector<capture::RigCamera> calibration_of(const DevicesConfig& devices,
                                               const std::filesystem::path& rig_file) {
  const capture::Rig rig = capture::read_rig(rig_file);
  std::vector<capture::RigCamera> known;
  for (const DeviceCamera& device : devices.cameras) {
    known.push_back(capture::camera_named(rig, rig_file, device.name,
                                          "name the configuration's [[camera]]s as they are named there"));
  }
  return known;
}

LiveCameras open_live_cameras(const DevicesConfig& devices, const std::filesystem::path& rig_file,
                              const ShadingConfig& config) {
  check(devices, rig_file);
  const std::vector<capture::RigCamera> known = calibration_of(devices, rig_file);
  LiveCameras views;
  views.devices = open_devices(devices);
  std::vector<PictureCamera> cameras;
  for (std::size_t i = 0; i < known.size(); ++i) {
    CameraInfo info = views.devices.cameras[i]->info();
    info.name = known[i].name;
    info.live = true;
    info.frame_count.reset();
    if (views.devices.open_trigger) {
      info.rate_hz = devices.program.slots_per_second;
    }
    cameras.push_back({info, std::nullopt});
  }
  // Called once, here: what is live is not looked at ahead.
  views.stages = open_shading(config, [&] {
    auto sets = std::make_unique<LiveSets>(cameras);
    views.sets = sets.get();
    return calibrated(std::move(sets), known, rig_file);
  });
  return views;
}

LiveCamerasPipeline::LiveCamerasPipeline(LiveCameras views, const ShadingPipeline::Options& options,
                                         std::vector<MeshSink*> sinks) {
  meshes_ = std::make_unique<ShadingPipeline>(std::move(views.stages), options, std::move(sinks));
  frames_ =
      std::make_unique<FramesPipeline>(std::move(views.devices), std::vector<FrameSetSink*>{views.sets});
  views.sets->set_ended([&frames = *frames_] {
    const PipelineState state = frames.status().state;
    return state == PipelineState::Ended || state == PipelineState::Failed;
  });
}

PipelineStatus LiveCamerasPipeline::status() const {
  PipelineStatus status = meshes_->status();
  PipelineStatus frames = frames_->status();
  if (frames.state == PipelineState::Failed && status.state != PipelineState::Failed) {
    status.state = frames.state;
    status.reason = frames.reason;
    status.failure_kind = frames.failure_kind;
  } else if (status.reason.empty()) {
    status.reason = frames.reason;
  }
  status.rig = std::move(frames.rig);
  return status;
}

}  // namespace facet::pipeline
