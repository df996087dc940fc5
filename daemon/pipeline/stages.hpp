#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "face/face_model.hpp"
#include "facet/camera.hpp"
#include "pipeline/monocular_config.hpp"
#include "refine/refine_stage.hpp"
#include "track/tracker.hpp"

namespace facet::pipeline {

/// The coarse tracker as the pipeline uses it; tests script one. One thread.
class CoarseStage {
 public:
  CoarseStage() = default;
  CoarseStage(const CoarseStage&) = delete;
  CoarseStage& operator=(const CoarseStage&) = delete;
  virtual ~CoarseStage() = default;

  /// Called once before the first frame: a recorded source may be looked at ahead, so that its first frames
  /// have meshes too. Asks `go_on` before each frame, which also says that it gets on; returns early where
  /// the answer is no.
  virtual void prepare(const std::function<bool()>& go_on) = 0;
  /// As track::Tracker::process: one picture of each camera, the reference camera's first.
  virtual const track::TrackResult& process(std::span<const Frame> views) = 0;
  /// As track::Tracker::reset_identity.
  virtual void reset_identity() = 0;
};

/// A camera beside the first one, in step with it.
struct FurtherCamera {
  std::unique_ptr<Camera> camera;
  track::View view;
};

/// A camera of a rig, opened.
struct CalibratedView {
  capture::RigCamera camera;
  std::filesystem::path rig_file;  ///< that it is from, for messages
  std::unique_ptr<Camera> source;  ///< hands out an empty frame for a moment that it did not see
};

/// Cameras with what the rig file knows of them, [camera_count] each.
std::vector<CalibratedView> calibrated_views(const std::vector<capture::RigCamera>& known,
                                             const std::filesystem::path& rig_file,
                                             std::vector<std::unique_ptr<Camera>> cameras);

/// Opens the cameras, the reference camera first. Frames of one moment have one number.
using OpenViews = std::function<std::vector<CalibratedView>()>;

/// Reads the frame of the same number from each further camera. go_on: asked while one keeps waiting.
/// Returns false, and why in `error`, where one has no such frame; false without an error where go_on says
/// no.
bool read_in_step(std::span<FurtherCamera> cameras, std::uint64_t sequence, std::vector<Frame>& out,
                  const std::function<bool()>& go_on, std::string& error);

/// What the pipeline connects.
struct Stages {
  std::unique_ptr<Camera> camera;
  std::vector<FurtherCamera> further_cameras;
  std::shared_ptr<const face::FaceModel> model;
  std::unique_ptr<CoarseStage> coarse;
  refine::OpenRefiner open_refiner;              ///< empty: refinement is off
  std::unique_ptr<refine::RefineStage> refiner;  ///< the first one; null where refinement is off
};

/// The tracker's configuration for a source: where the configuration gives no intrinsics, those that the
/// source knows of itself count.
track::TrackerConfig tracker_config(const MonocularConfig& config, const CameraInfo& source);

/// Opens source, model, tracker and device. Seconds, for the kernels are compiled. Throws Error:
/// UnreadableInput for source, model and landmark nets, NoDevice where no Vulkan device is usable, Usage
/// where the views' videos do not go together.
Stages open_stages(const MonocularConfig& config);

/// The same with the pictures of these cameras instead of the configuration's. They are opened twice where
/// they are recorded: once to look ahead.
Stages open_stages(const MonocularConfig& config, const OpenViews& open);

}  // namespace facet::pipeline
