#include "pipeline/booth.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "facet/error.hpp"

namespace facet::pipeline {

void check(const DevicesConfig& devices, const BoothConfig& booth) {
  check(devices);
  check(booth);
  if (devices.trigger == TriggerKind::None) {
    throw Error(ErrorKind::Usage,
                "mode \"booth\" needs a trigger, which says what the projectors show in which slot: set "
                "trigger.kind");
  }
}

Booth open_booth(const DevicesConfig& devices, const BoothConfig& config) {
  check(devices, config);
  Booth booth;
  booth.stages = open_booth(config, 1);
  for (const capture::RigCamera& camera : booth.stages.rig->cameras) {
    const bool known = std::any_of(devices.cameras.begin(), devices.cameras.end(),
                                   [&](const DeviceCamera& device) { return device.name == camera.name; });
    if (!known) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("{}: camera '{}' is not among the [[camera]]s of the configuration: names must agree",
                      config.rig_file.string(), camera.name));
    }
  }
  booth.devices = open_devices(devices);
  return booth;
}

BoothPipeline::BoothPipeline(Booth booth, std::vector<FrameSetSink*> set_sinks,
                             std::vector<MeshSink*> mesh_sinks) {
  meshes_ = std::make_unique<BoothMeshes>(std::move(booth.stages), BoothMeshes::WhenBusy::Drop,
                                          std::move(mesh_sinks));
  set_sinks.push_back(meshes_.get());
  frames_ = std::make_unique<FramesPipeline>(std::move(booth.devices), std::move(set_sinks));
}

PipelineStatus BoothPipeline::status() const {
  PipelineStatus status = meshes_->status();
  PipelineStatus frames = frames_->status();
  if (status.state != PipelineState::Failed) {
    status.state = frames.state;
    status.failure_kind = frames.failure_kind;
    status.reason = frames.reason;
  }
  status.captured = frames.captured;
  status.dropped += frames.dropped;
  status.rig = std::move(frames.rig);
  return status;
}

}  // namespace facet::pipeline
