#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "facet/camera.hpp"
#include "facet/trigger.hpp"
#include "pipeline/devices_config.hpp"
#include "pipeline/frame_set_sink.hpp"
#include "pipeline/pipeline.hpp"

namespace facet::pipeline {

/// Opens the lines of a trigger program. Throws Error(Unavailable) where they can't be had now.
using OpenTrigger = std::function<std::unique_ptr<Trigger>()>;

/// The devices, opened.
struct Devices {
  DevicesConfig config;
  std::vector<std::unique_ptr<Camera>> cameras;  ///< [camera_count]
  OpenTrigger open_trigger;                      ///< empty: the cameras run freely
};

/// Opens the cameras. Throws Error: Usage where the configuration or a camera can't be so, UnreadableInput
/// for a file. Cameras that are absent and lines that are busy are states.
Devices open_devices(const DevicesConfig& config);

/// Several cameras in, frame sets out, no meshes: what the cameras of one trigger slot saw goes to the sinks.
///
/// Threads, what each does and what it may block on:
/// * `facet-cam-N`: Camera::start, next, stop of one camera. The source.
/// * `facet-edges`: opens the trigger, again with pauses of 1 to 10 s where it fails; Trigger::next; writes
///   the edge log. GPIO devices, the disk.
/// * `facet-sets`: takes the sets, FrameSetSink::deliver. The sets, a sink.
///
/// A camera that is gone leaves its place in the sets empty (degraded), a trigger that is gone leaves out the
/// sets; both are told in the status, and go on by themselves. A camera that streams and stays out of step
/// is restarted, after 5 s and then with pauses that grow to a minute; as long as it is out of step its
/// pictures are left out. While the trigger stands still its cameras wait: their silence is no stall. Ends
/// where every camera is at its end.
class FramesPipeline final : public Pipeline {
 public:
  FramesPipeline(Devices devices, std::vector<FrameSetSink*> sinks);
  ~FramesPipeline() override;

  void start() override;
  void request_stop() override;
  void stop() override;
  bool finished() const override;
  PipelineStatus status() const override;
  std::optional<Progress::Silence> longest_silence() const override;
  void reset_identity() override;
  std::vector<Messages::Message> take_messages() override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::pipeline
