#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "pipeline/bounded_queue.hpp"
#include "pipeline/frames.hpp"
#include "pipeline/picture_source.hpp"
#include "pipeline/sets_pipeline.hpp"
#include "pipeline/shading.hpp"

namespace facet::pipeline {

/// Frame sets on their way from FramesPipeline to ShadingPipeline: the newest, older ones are dropped. How
/// the devices do is FramesPipeline's to know.
class LiveSets final : public FrameSetSink, public PictureSource {
 public:
  /// cameras: named as in the sets.
  explicit LiveSets(std::vector<PictureCamera> cameras) : cameras_(std::move(cameras)) {}
  /// ended: whether no more sets come; before the first `next`.
  void set_ended(std::function<bool()> ended) { ended_ = std::move(ended); }

  void deliver(std::shared_ptr<const FrameSet> set) override;

  std::vector<PictureCamera> cameras() const override { return cameras_; }
  CameraStatus status() const override { return {}; }
  void start() override {}
  CaptureOutcome next(FrameSet& out, std::chrono::milliseconds timeout) override;
  void stop() override {}
  std::string last_error() const override { return {}; }

 private:
  std::vector<PictureCamera> cameras_;
  std::function<bool()> ended_;
  BoundedQueue<std::shared_ptr<const FrameSet>> newest_{1};
};

/// The devices and stages of several calibrated cameras that see one face, opened.
struct LiveCameras {
  Devices devices;
  ShadingParts stages;
  LiveSets* sets = nullptr;  ///< whose pictures the stages are given; theirs
};

/// Throws Error(Usage) where no face can be followed with these cameras.
void check(const DevicesConfig& devices, const std::filesystem::path& rig_file);

/// What the rig file knows of the devices' cameras, in their order; it may have others, too. Throws
/// Error(Usage) where it lacks one, UnreadableInput where it can't be read.
std::vector<capture::RigCamera> calibration_of(const DevicesConfig& devices,
                                               const std::filesystem::path& rig_file);

/// Opens cameras, rig file and stages; see open_devices and open_shading. The first camera is the reference
/// camera. Throws Error(Usage), too, where the rig file does not have a camera, or in another size.
LiveCameras open_live_cameras(const DevicesConfig& devices, const std::filesystem::path& rig_file,
                              const ShadingConfig& config);

/// Several calibrated cameras live, refined meshes out: frame sets as FramesPipeline makes them, meshes as
/// ShadingPipeline makes them of each; their threads. Sets for which the stages are too slow are dropped
/// and counted. A camera that is gone is missing in the sets: the meshes go on with the others and are marked
/// as degraded, the status says what became of it.
class LiveCamerasPipeline final : public SetsPipeline<ShadingPipeline> {
 public:
  LiveCamerasPipeline(LiveCameras views, const ShadingPipeline::Options& options,
                      std::vector<MeshSink*> sinks);

  PipelineStatus status() const override;
};

}  // namespace facet::pipeline
