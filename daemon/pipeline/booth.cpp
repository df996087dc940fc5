#include "pipeline/booth.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "facet/error.hpp"

namespace facet::pipeline {
namespace {

std::vector<MeshSink*> with(std::vector<MeshSink*> sinks, MeshSink* last) {
  sinks.push_back(last);
  return sinks;
}

}  // namespace

void check(const RigConfig& devices, const BoothConfig& booth) {
  check(devices);
  check(booth);
  if (devices.trigger == TriggerKind::None) {
    throw Error(ErrorKind::Usage,
                "mode \"booth\" needs a trigger, which says what the projectors show in which slot: set "
                "trigger.kind");
  }
}

Booth open_booth(const RigConfig& devices, const BoothConfig& config) {
  check(devices, config);
  Booth booth;
  booth.stages = open_booth(config, 1);
  for (const capture::RigCamera& camera : booth.stages.rig->cameras) {
    const bool known = std::any_of(devices.cameras.begin(), devices.cameras.end(),
                                   [&](const RigCamera& device) { return device.name == camera.name; });
    if (!known) {
      throw Error(
          ErrorKind::Usage,
          fmt::format("{}: camera '{}' is not among the [[camera]]s of the configuration: names must agree",
                      config.rig_file.string(), camera.name));
    }
  }
  booth.devices = open_rig(devices);
  return booth;
}

BoothPipeline::BoothPipeline(Booth booth, std::vector<MeshSink*> set_sinks, std::vector<MeshSink*> mesh_sinks)
    : meshes_(std::move(booth.stages), BoothMeshes::WhenBusy::Drop, std::move(mesh_sinks)),
      frames_(std::move(booth.devices), with(std::move(set_sinks), &meshes_)) {}

BoothPipeline::~BoothPipeline() {
  BoothPipeline::stop();
}

void BoothPipeline::start() {
  meshes_.start();
  frames_.start();
}

void BoothPipeline::request_stop() {
  frames_.request_stop();
  meshes_.request_stop();
}

void BoothPipeline::stop() {
  request_stop();
  frames_.stop();
  meshes_.stop();
}

bool BoothPipeline::finished() const {
  return frames_.finished() && meshes_.finished();
}

PipelineStatus BoothPipeline::status() const {
  PipelineStatus status = frames_.status();
  meshes_.fill(status);
  return status;
}

std::optional<Progress::Silence> BoothPipeline::longest_silence() const {
  const auto frames = frames_.longest_silence();
  const auto meshes = meshes_.longest_silence();
  return !frames || (meshes && meshes->length > frames->length) ? meshes : frames;
}

void BoothPipeline::reset_identity() {
  meshes_.reset_identity();
}

std::vector<Messages::Message> BoothPipeline::take_messages() {
  std::vector<Messages::Message> messages = frames_.take_messages();
  const std::vector<Messages::Message> more = meshes_.take_messages();
  messages.insert(messages.end(), more.begin(), more.end());
  return messages;
}

}  // namespace facet::pipeline
