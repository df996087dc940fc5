#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>

#include "face/face_model.hpp"
#include "pipeline/picture_source.hpp"
#include "pipeline/shading_config.hpp"
#include "pipeline/status.hpp"
#include "refine/refine_stage.hpp"
#include "track/tracker.hpp"

namespace facet::pipeline {

/// What the pictures told of the person in them.
struct LearnedPerson {
  std::shared_ptr<const face::FaceModel> model;    ///< null: the configured one is followed
  std::string note;                                ///< for the log; empty where nothing is to be said
  std::shared_ptr<const LearningStatus> learning;  ///< live sources; another object whenever it changes
};

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
  /// Valid once prepare() is back; of live sources it may be another after each process().
  virtual const LearnedPerson& learned() const = 0;
  /// While `keep` is set, learned() changes for no other reason than that somebody else is seen.
  virtual void keep_model(bool keep) = 0;
  /// As track::Tracker::process: one picture of each camera, the reference camera's first.
  virtual const track::TrackResult& process(std::span<const Frame> views) = 0;
  /// As track::Tracker::reset_identity.
  virtual void reset_identity() = 0;
  /// The lamps fire in turn while the head holds still, and what it looks like under them counts for whoever
  /// is being learned, in the place of an earlier burst. Nothing where there are no lamps, nobody is being
  /// looked at to be learned (LearningStatus::State::Looking), none is tracked, or they fire already.
  virtual void burst() {}
  /// What goes on beside the frames is broken off. Any thread, returns at once.
  virtual void request_stop() = 0;
};

/// What the pipeline connects.
struct ShadingParts {
  std::unique_ptr<PictureSource> pictures;
  std::shared_ptr<const face::FaceModel> model;
  std::string person;  ///< whose model it is; empty: anybody's
  std::unique_ptr<CoarseStage> coarse;
  refine::OpenRefiner open_refiner;              ///< empty: refinement is off
  std::unique_ptr<refine::RefineStage> refiner;  ///< the first one; null where refinement is off
};

/// The tracker's configuration for a source: where the configuration gives no intrinsics, those that the
/// source knows of itself count.
track::TrackerConfig tracker_config(const ShadingConfig& config, const CameraInfo& source);

/// Opens pictures, model, tracker and device. Seconds, for the kernels are compiled. open: empty for the
/// configuration's source, or its recorded views. Throws Error: what opening the pictures throws,
/// UnreadableInput for model and landmark nets, NoDevice where no Vulkan device is usable.
ShadingParts open_shading(const ShadingConfig& config, OpenPictures open = {});

}  // namespace facet::pipeline
